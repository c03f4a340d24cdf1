"""Records that OpenSees makes of a layered column under Iwan's plasticity, in place of this program's law: records.py CASE SEED FOLDER.

14 events of 15 s at the base and three depths, 2 % of white noise, cut at 20 Hz, nothing from before the events. CASE is what the site has that
its manifest does not: nothing, damping (three times as much), seam (half the velocity from 9.0 to 10.2 m), nonlinear (reference strains
times 0.45), gain (0.82 at 6 m). Needs openseespy, whose 3.8 runs with Python 3.12.
"""

import os
import sys

import numpy as np
import openseespy.opensees as ops

STEP_S, N_STEP, GRAVITY_M_S2 = 0.005, 3000, 9.81
DEPTH_M, N_ELEMENT = 30.0, 75
SENSORS_M = {"S15": 15.0, "S6": 6.0, "SURF": 0.0}
# Thickness m, density kg/m³, velocity m/s, reference strain.
LAYERS = [(5.0, 1800.0, 170.0, 4e-4), (10.0, 1900.0, 240.0, 6e-4), (15.0, 2000.0, 330.0, 9e-4)]
CURVATURE = 0.919
# Rayleigh damping of 1.5 % at 1 and 10 Hz.
RATIO, LOW, HIGH = 0.015, 2 * np.pi * 1.0, 2 * np.pi * 10.0
ALPHA_1_S, BETA_S = 2 * RATIO * LOW * HIGH / (LOW + HIGH), 2 * RATIO / (LOW + HIGH)


def soil(case, depth_m):
    """Density, velocity and reference strain at a depth."""
    bottom_m = 0.0
    for thickness_m, density, velocity, strain in LAYERS:
        bottom_m += thickness_m
        if depth_m < bottom_m:
            if case == "seam" and 9.0 < depth_m < 10.2:
                velocity *= 0.5
            return density, velocity, strain * (0.45 if case == "nonlinear" else 1.0)
    raise ValueError(depth_m)


def base_motion(random):
    """A made-up motion with a largest acceleration of one."""
    f = np.fft.rfftfreq(N_STEP, STEP_S)
    middle_hz, width = random.uniform(1.0, 4.0), random.uniform(0.5, 1.2)
    white, t = random.standard_normal(N_STEP), np.arange(N_STEP) * STEP_S
    rise_s = random.uniform(1.5, 4.0)
    lasting = np.exp(-np.clip(t - 1 - rise_s - random.uniform(0, 2), 0, None) / random.uniform(1.0, 2.5))
    envelope = (t > 1) * np.clip((t - 1) / rise_s, 0, 1) ** 2 * lasting
    shape = np.exp(-0.5 * (np.log(np.maximum(f, 1e-3) / middle_hz) / width) ** 2) + 0.15
    shape *= (f / 0.3) ** 4 / (1 + (f / 0.3) ** 4) / (1 + (f / 15.0) ** 8)
    motion = np.fft.irfft(np.fft.rfft(white * envelope) * shape, N_STEP)
    return motion / np.abs(motion).max()


def response(case, base):
    """Absolute accelerations of the sensors, m/s²."""
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 2)
    height_m = DEPTH_M / N_ELEMENT
    for i in range(N_ELEMENT + 1):
        for side in (0, 1):
            ops.node(2 * i + 1 + side, float(side), i * height_m - DEPTH_M)
            ops.fix(2 * i + 1 + side, int(i == 0), 1)
        if i > 0:
            ops.equalDOF(2 * i + 1, 2 * i + 2, 1)
    strains = np.logspace(-6, -1.3, 30)
    for i in range(N_ELEMENT):
        density, velocity, reference = soil(case, DEPTH_M - (i + 0.5) * height_m)
        modulus_kpa = density * velocity**2 / 1e3
        curve = [float(v) for g in strains for v in (g, 1 / (1 + (g / reference) ** CURVATURE))]
        ops.nDMaterial(
            "PressureIndependMultiYield", i + 1, 2, density / 1e3, modulus_kpa, modulus_kpa * 4.67, 100.0, 0.1, 0.0, 100.0, 0.0, -len(strains), *curve
        )
        ops.element("quad", i + 1, 2 * i + 1, 2 * i + 2, 2 * i + 4, 2 * i + 3, 1.0, "PlaneStrain", i + 1)
        ops.updateMaterialStage("-material", i + 1, "-stage", 1)
    times = 3.0 if case == "damping" else 1.0
    ops.rayleigh(ALPHA_1_S * times, 0.0, BETA_S * times, 0.0)
    ops.timeSeries("Path", 1, "-dt", STEP_S, "-values", *[float(a) for a in base], "-factor", 1.0)
    ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("BandGeneral")
    ops.test("NormUnbalance", 1e-4, 40)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    found = {name: np.zeros(N_STEP) for name in SENSORS_M}
    for step in range(1, N_STEP):
        if ops.analyze(1, STEP_S) != 0 and any(ops.analyze(1, STEP_S / 10) != 0 for _ in range(10)):
            raise SystemExit(f"no equilibrium at {step * STEP_S} s")
        for name, depth_m in SENSORS_M.items():
            node = 2 * round((DEPTH_M - depth_m) / height_m) + 1
            found[name][step] = ops.nodeAccel(node, 1) + base[step]
    return found


def recorded(motion, random):
    noisy = motion + 0.02 * np.sqrt(np.mean(motion**2)) * random.standard_normal(N_STEP)
    f = np.fft.rfftfreq(N_STEP, STEP_S)
    return np.fft.irfft(np.fft.rfft(noisy) / np.sqrt(1 + (f / 20.0) ** 12), N_STEP)


def main():
    case, seed, folder = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    if case not in ("nothing", "damping", "seam", "nonlinear", "gain"):
        raise SystemExit(f"no case `{case}`")
    random = np.random.default_rng(seed)
    os.makedirs(folder, exist_ok=True)
    pga_g = np.geomspace(0.008, 0.12, 14)
    random.shuffle(pga_g)
    for event, largest in enumerate(pga_g):
        base = base_motion(random) * largest * GRAVITY_M_S2
        outputs = response(case, base)
        columns = [recorded(x, random) for x in (base, *outputs.values())]
        if case == "gain":
            columns[2] *= 0.82
        table = np.column_stack([np.arange(N_STEP) * STEP_S, *columns])
        header = "time_s,BASE," + ",".join(SENSORS_M)
        np.savetxt(f"{folder}/E{event:02}.EW.csv", table, fmt=["%.3f"] + ["%.8e"] * 4, delimiter=",", header=header, comments="")


main()
