"""Prints the numbers that the tests of src/metrics hold, from published implementations.

    pip install obspy==1.5.1 eqsig==1.2.17 pyrotd==0.6.1 scipy && python tests/metrics/vectors.py

Anderson's criteria are those of the Broadband Platform of SCEC (github.com/SCECcode/bbp): with its folder bbp/comps in BBP_COMPS
they are printed too. Its plots and configuration are not needed.
"""
import os
import sys
import warnings
from unittest.mock import MagicMock

import numpy as np

warnings.simplefilter("ignore")
import eqsig
import pyrotd
from obspy.signal.konnoohmachismoothing import konno_ohmachi_smoothing_window
from scipy import stats
from scipy.integrate import cumulative_trapezoid

DT = 0.01
t = np.arange(2001) * DT


def history(first, second, lag):
    s = t - lag
    return first * np.sin(2 * np.pi * 1.3 * s) * np.exp(-(((s - 8) / 3) ** 2)) + second * np.sin(
        2 * np.pi * 4.7 * s + 1
    ) * np.exp(-(((s - 6) / 1.5) ** 2))


observed, predicted = history(1.0, 0.5, 0.0), history(1.2, 0.35, 0.03)

for name, x in (("observed", observed), ("predicted", predicted)):
    n = 2 * len(x)
    lines = np.fft.rfftfreq(n, DT)
    amplitude = np.abs(np.fft.rfft(x, n)) * DT
    smoothed = [
        float((amplitude * konno_ohmachi_smoothing_window(lines, f, bandwidth=40, normalize=True)).sum())
        for f in (1.2, 1.3, 1.5, 4.5, 4.7)
    ]
    print(name, "Konno-Ohmachi", smoothed)
    signal = eqsig.AccSignal(x, DT)
    print(name, "Arias", float(eqsig.im.calc_arias_intensity(signal)[-1]))
    print(name, "D5-95", eqsig.im.calc_sig_dur_vals(x, DT, 0.05, 0.95), "D5-75", eqsig.im.calc_sig_dur_vals(x, DT, 0.05, 0.75))
    print(name, "PGA", float(np.abs(x).max()), "PGV", float(np.abs(cumulative_trapezoid(x, dx=DT)).max()))
    periods = np.array([0.05, 0.2, 0.5, 1.0, 3.0])
    print(name, "PSA eqsig", eqsig.sdof.pseudo_response_spectra(x, DT, periods, 0.05)[2].tolist())
    print(name, "PSA pyrotd", pyrotd.calc_spec_accels(DT, x, 1 / periods, 0.05)["spec_accel"].tolist())

print("t quantiles 0.975", [float(stats.t.ppf(0.975, n)) for n in (1, 2, 3, 8, 30)])
d = [-3.0, -1.0, -4.0, -2.5, 0.5]
print("t interval", stats.t.interval(0.95, 4, np.mean(d), stats.sem(d)), "sign", stats.binomtest(1, 5).pvalue)
print("Pearson", stats.pearsonr(observed, predicted)[0])

if "BBP_COMPS" in os.environ:
    for name in ("matplotlib", "matplotlib.pyplot", "pylab", "bband_utils", "plot_config", "install_cfg", "station_list"):
        sys.modules[name] = MagicMock()
    sys.path.insert(0, os.environ["BBP_COMPS"])
    from anderson_gof import AndersonGOF

    gof = AndersonGOF(None, "", 0)
    gof.dt = DT
    pair = (predicted, observed)
    velocity = [cumulative_trapezoid(x, dx=DT, initial=0) for x in pair]
    displacement = [cumulative_trapezoid(x, dx=DT, initial=0) for x in velocity]
    c1, c3 = gof.c13_eval(*pair)
    c2, c4 = gof.c24_eval(*velocity)
    # It takes the largest value for the peak, this program the largest size.
    peaks = [f(*map(np.abs, x)) for f, x in ((gof.c5_eval, pair), (gof.c6_eval, velocity), (gof.c7_eval, displacement))]
    spectra = [1.0, 2.0, 4.0], [1.1, 1.5, 4.0]
    c8, c9 = gof.c8_eval(*spectra, spectra[0]), gof.c9_eval(*spectra, spectra[0])
    print("Anderson", [float(c) for c in (c1, c2, c3, c4, *peaks, c8, c9, gof.c10_eval(*pair))])
