"""Writes one made-up event in the text formats that strong motion comes in, as `tests/record_formats.rs` reads it.

Acceleration of channel k at time t, cm/s2: (20 + 5 k) sin(2 pi (0.7 + 0.3 k) t) exp(-((t - 2) / 1.5)^2), 400 samples at 0.01 s.
Channels 1 and 2 are at 30 m (azimuths 0 and 90), 3 and 4 at the surface (azimuths 20 and 110), 5 is vertical.
Layouts: COSMOS strong-motion data format 1.20; CSMIP volume 2; SMC of the US Geological Survey; PEER AT2.
"""

from math import exp, pi, sin
from pathlib import Path

N, DT = 400, 0.01
CHANNELS = {1: 0, 2: 90, 3: 20, 4: 110, 5: None}
HERE = Path(__file__).parent


def value(k, i):
    t = i * DT
    return (20 + 5 * k) * sin(2 * pi * (0.7 + 0.3 * k) * t) * exp(-(((t - 2) / 1.5) ** 2))


def rows(values, columns, form):
    return ["".join(form(v) for v in values[i : i + columns]) for i in range(0, len(values), columns)]


def cosmos(k):
    ints, reals = [-999] * 100, [-999.0] * 100
    ints[0:5] = [2, 1, 4, 120, 1]
    ints[10], ints[18] = 5, 1
    ints[39:45] = [2021, 60, 3, 1, 7, 30]
    ints[49], ints[53] = k, 400 if CHANNELS[k] is None else (CHANNELS[k] or 360)
    ints[75] = 0
    samples = [value(k, i) for i in range(N)]
    reals[0:3] = [37.0, -122.0, 10.0]
    reals[21], reals[29], reals[33], reals[34], reals[39], reals[40], reals[41] = 2.0, 15.25, DT, N * DT, 100.0, 0.7, 1.25
    reals[61:64] = [1000 * DT, N * DT, max(samples, key=abs)]
    reals[87] = 980.665
    text = [
        "Corrected acceleration    (Format v01.20 with 13 text lines)",
        "Record of a made-up event of Mon Mar 01, 2021 07:30 UTC",
        "Hypocenter: 37.00000 -122.00000 H= 10km Mw=5.0",
        "Origin: 2021/03/01 07:30:00    UTC",
        "Statn No: 05-000001 Code:CE-00001   CGS  Made-up array",
        "Coords: 37.0000 -122.0000  Site geology:",
        "Recorder: (see cmnt)      (   Chns of   5 at Sta) Sensor: (see comment)",
        "Rcrd start time: 2021/03/01 07:30:15.250 UTC (Q=5) RcrdId: (see comment)",
        f"Sta Chan   {k}:{'Up' if CHANNELS[k] is None else str(CHANNELS[k]) + ' Deg'}  (Rcrdr Chan  {k}) Location:{'30 m' if k < 3 else 'Surface'}",
        f"Raw record length = {N * DT:.3f} sec, Uncor max =    1, at  2.000 sec.",
        "Processed:2021-03-02 05:46:55 GMT, CGS, Max =   -6.852 cm/sec2 at   2.000 sec",
        "Record filtered below  0.03 Hz (periods over 33.33 secs), and above 20.0 Hz",
        "Values used when parameter or data value is unknown/unspecified:   -999, -999.00",
    ]
    return (
        text
        + [" 100 Integer-header values follow on  10 lines, Format= (10I8)"]
        + rows(ints, 10, lambda v: f"{v:8d}")
        + [" 100 Real-header values follow on  20 lines, Format= (5F15.6)"]
        + rows(reals, 5, lambda v: f"{v:15.6f}")
        + ['   2 Comment line(s) follow, each starting with a "|":', "| Made up", "| RcrdId: made.up"]
        + [f"{N:8d} acceleration pts, approx   {int(N * DT)} secs, units=cm/sec2(04),Format=(8F10.5)"]
        + rows(samples, 8, lambda v: f"{v:10.5f}")
        + [f"End-of-data for Sta Chan {k} acceleration"]
    )


def csmip(k):
    ints, reals = [0] * 100, [0.0] * 100
    ints[26] = 500 if CHANNELS[k] is None else (CHANNELS[k] or 360)
    ints[29], ints[52], ints[63], ints[65] = 13, N, N, N
    reals[60] = DT
    name = "Up" if CHANNELS[k] is None else f"{CHANNELS[k] or 360} Deg"
    text = [
        f"Corrected accelerogram   00001-L0001-21060.01       Chan  {k}:  {name}",
        "Uncorrected Accelerogram Data             Processed: 03/02/21",
        "Rcrd of Mon Mar  1, 2021 07:30:15.3 UTC",
        "Made up                                 (Origin:  To be determined)",
        "00001-L0001-21060.01                 Start time:  3/01/21, 07:30:15.2 UTC (GPS)",
        "Station No. 00001   37.000N, 122.000W    Etna    s/n 0001  (5 Chns of  5 at Sta)",
        "Made-up array                             XX    Data: Acceleration",
        f"Chan  {k}:  {name}",
    ]
    text += ["Rcrd of Mon Mar  1, 2021 07:30:15.3 UTC"] + [""] * (25 - len(text) - 1)

    def block(what, unit, values):
        head = f"{N:6d} points of {what} data equally spaced at  .010 sec, in {unit}. (8f10.5)"
        return [head] + rows(values, 8, lambda v: f"{v:10.5f}")

    samples = [value(k, i) for i in range(N)]
    return (
        text
        + rows(ints, 16, lambda v: f"{v:5d}")
        + rows(reals, 8, lambda v: f"{v:10.5f}")
        + block("accel", "cm/sec2", samples)
        + block("veloc", "cm/sec", [0.0] * N)
        + block("displ", "cm", [0.0] * N)
        + [f"/&  ----------  End of data for channel  {k}  ----------"]
    )


def smc(k):
    ints, reals = [-32768] * 48, [1.7e38] * 50
    ints[1:7] = [2021, 60, 7, 30, 15, 250]
    ints[12], ints[13] = (0, -32768) if CHANNELS[k] is None else (-32768, CHANNELS[k] or 360)
    ints[15], ints[16] = 2, N
    ints[17] = -32768
    reals[1] = 1 / DT
    text = ["2 CORRECTED ACCELEROGRAM", "*", "0001", "     2021  03  01    0730 MADE UP", "Moment Mag= 5.00     Ms=          Ml="]
    text += [f"station = XX: Made-up array              component= {'UP' if CHANNELS[k] is None else CHANNELS[k] or 360}"]
    text += ["epicentral dist =    10.0       pk acc =  2.00E+1", "inst type=K2         data source = USGS", "*", "*", "*"]

    def narrow(v):
        # Two digits of an exponent leave no room for a sign.
        v = 0.0 if abs(v) < 1e-9 else v
        mantissa, exponent = f"{v:.4E}".split("E")
        return f"{mantissa}E{int(exponent):+d}".rjust(10)

    return (
        text
        + rows(ints, 8, lambda v: f"{v:10d}")
        + rows(reals, 5, lambda v: f"{v:15.7E}")
        + ["|", "| Made up"]
        + rows([value(k, i) for i in range(N)], 8, narrow)
    )


def at2(k):
    head = [
        "PEER NGA STRONG MOTION DATABASE RECORD",
        f"Made up, 3/1/2021, Made-up array, {'UP' if CHANNELS[k] is None else CHANNELS[k]}",
        "ACCELERATION TIME SERIES IN UNITS OF G",
        f"NPTS=  {N}, DT=   {DT:.4f} SEC,",
    ]
    return head + rows([value(k, i) / 980.665 for i in range(N)], 5, lambda v: f"{v:15.7E}")


def write(name, lines):
    (HERE / name).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write("20210301_cosmos.v2", [line for k in CHANNELS for line in cosmos(k)])
    write("20210301_csmip.V2", [line for k in CHANNELS for line in csmip(k)])
    for k in CHANNELS:
        write(f"20210301_{k}.smc", smc(k))
        write(f"RSN1_20210301_{k}.AT2", at2(k))
