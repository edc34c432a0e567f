"""Sound and the three ways of measuring stiffness, against truths of their own.

.venv/bin/python tools/bench_sound.py [RUNS]      Monte-Carlo runs, 200 unless told
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import HEAD, Row, cells  # noqa: E402

from edge_daemon.config.settings import ChannelSettings, Drive, Estimation, Sound  # noqa: E402
from edge_daemon.gear import steps  # noqa: E402
from edge_daemon.gear.torques import law  # noqa: E402
from edge_daemon.identify.fit import fit  # noqa: E402
from edge_daemon.records import Burst, Status  # noqa: E402
from edge_daemon.rig.plant import Influence  # noqa: E402
from edge_daemon.sound.noise_estimator import NoiseEstimator  # noqa: E402
from edge_daemon.sound.noise_model import fit_noise  # noqa: E402
from edge_daemon.sound.sound_file import fit_sound_file  # noqa: E402
from edge_daemon.sound.spectrum import Spectrum  # noqa: E402
from edge_daemon.stiffness.methods import compare_methods, measure  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from edge_daemon.track.live import DriveEstimator  # noqa: E402
from tests.excite import test_rig_stiffness as bench  # noqa: E402
from tests.motion import simulated_joint as rig  # noqa: E402
from tests.sound import test_sound_angle as ear  # noqa: E402
from tests.sound.test_sound_file import density, sound, write_wav  # noqa: E402

RUNS = 200
TONES, SWEEP = ((5.37, 0.4), (9.13, 0.4), (13.77, 0.4), (19.33, 0.4)), (0.23, 1.2)
"""repeats after the 30 s of the record only. A motion of tenths of a hertz repeats thrice in it, and its rounding
errors with it: they do not average out, and errors of k1 and k2 were 1.73 times their sd, the root of three"""
WAV_HZ, WAV_S = 16_000, 8.0


class Recording(NamedTuple):
    """What a fit takes."""

    time_s: np.ndarray
    columns: dict[str, np.ndarray]


SPECTRA = {
    "equal": np.ones(5),
    "steep": np.array([0.1, 0.1, 0.1, 1.0, 3.0]),
    "own": np.array([1.0, 3.0, 10.0, 3.0, 1.0]),
}
"""coefficients at 300 Hz"""
FREQUENCY = np.linspace(10.0, 10_000.0, 999)
STIFFNESS = 2e4


def bound(a: np.ndarray, frequency: np.ndarray, averages: float) -> np.ndarray:
    """(5,) Cramer-Rao sd of the coefficients from so many averages of independent bins."""
    columns = np.stack([(frequency / 300.0) ** -b for b in range(5)], axis=1) / density(a, frequency)[:, None]
    size = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / size
    return np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled)) / averages) / size


def of_spectra(runs: int) -> list[Row]:
    """Spectra whose bins scatter as a Gamma law: few averages and many."""
    rows, most = [], 0
    for averages in (4.0, 100.0):
        errors, scores = [], []
        for name, a in SPECTRA.items():
            rng = np.random.default_rng(len(name))
            least = bound(a, FREQUENCY, averages)
            for _ in range(runs):
                psd = density(a, FREQUENCY) * rng.gamma(averages, 1 / averages, 999)
                seen = fit_noise(Spectrum(FREQUENCY, psd, averages))
                known = least < a / 3  # below, the law of the error is no normal one
                errors += list(((seen.value - a) / least)[known])
                scores += list(((seen.value - a) / seen.sd)[known])
                most = max(most, seen.iterations)
        rows += _honest(f"spectrum, {averages:g} averages", np.array(errors), np.array(scores), len(scores))
    return [*rows, Row("spectra: most iterations", most, "1", 12.0, peer=f"{6 * runs} fits, 4 averages among them")]


def of_articles(runs: int) -> list[Row]:
    """Error of each coefficient by the articles' own ways and by ours, on equal coefficients and 100 averages."""
    design = np.stack([(FREQUENCY / 300.0) ** -b for b in range(5)], axis=1)
    five = np.round(np.geomspace(1, len(FREQUENCY), 5) - 1).astype(int)
    ways = {
        "five points": lambda psd: np.linalg.solve(design[five], psd[five]),
        "least squares over all": lambda psd: np.linalg.lstsq(design, psd, rcond=None)[0],
        "used": lambda psd: fit_noise(Spectrum(FREQUENCY, psd, 100.0)).value,
    }
    rng = np.random.default_rng(5)
    spectra = [design.sum(axis=1) * rng.gamma(100.0, 0.01, len(FREQUENCY)) for _ in range(runs)]
    rows = []
    for name, way in ways.items():
        spread = np.sqrt(np.mean([(way(psd) - 1.0) ** 2 for psd in spectra], axis=0))
        each = ", ".join(f"{100 * s:.3g}" for s in spread)
        rows.append(Row(f"noise by {name}: error of a0", 100 * float(spread[0]), "%", peer=f"a0..a4: {each} %"))
    return rows


def _honest(name: str, errors: np.ndarray, scores: np.ndarray, count: int) -> list[Row]:
    chance = 2 * math.sqrt(0.05 * 0.95 / (count / 3)) * 100  # coefficients of one fit are not independent
    inside = 100 * float(np.mean(np.abs(scores) < 1.96))
    return [
        Row(f"{name}: RMSE over Cramer-Rao", float(np.sqrt(np.mean(errors**2))), "1", 1.15, peer=f"{count} values"),
        Row(f"{name}: 95 % interval covers", inside, "%", 93.0 - chance, True),
    ]


def of_files(runs: int) -> list[Row]:
    """WAV files of a steep noise that goes on below the band, 16 bits."""
    errors, scores, most = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        for a in SPECTRA.values():
            least = bound(a, np.arange(10.0, 0.45 * WAV_HZ, 1 / WAV_S), 1.0)
            for seed in range(math.ceil(runs / len(SPECTRA))):
                value = sound(a, WAV_HZ, WAV_S, seed, below_hz=(0.5, 3.0, 10.0)[seed % 3])
                scale = 0.1 / value.std()
                file = write_wav(Path(folder) / "a.wav", (scale * value)[None], WAV_HZ, 24)
                seen = fit_sound_file(file).fit
                error = seen.value / scale**2 - a
                errors.append(error / least)
                scores.append(error * scale**2 / seen.sd)
                most = max(most, seen.iterations)
        rows = _long(Path(folder))
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    inside = 100 * np.mean(np.abs(scores) < 1.96, axis=0)
    chance = 200 * math.sqrt(0.05 * 0.95 / len(scores))
    return [
        Row("WAV of 8 s: 95 % interval covers, worst of a0..a4", float(inside.min()), "%", 93.0 - chance, True),
        Row("WAV of 8 s: bias over sd, worst", float(np.abs(np.mean(scores, axis=0)).max()), "1", 0.2 + 0.14),
        Row(
            "WAV of 8 s: RMSE over the bound of all its samples, worst",
            float(spread.max()),
            "1",
            peer=f"{len(scores)} files; {float(np.median(spread)):.2f} in the middle; a window costs",
        ),
        Row("WAV of 8 s: most iterations", most, "1", 10.0),
        *rows,
    ]


def _long(folder: Path) -> list[Row]:
    """Ten minutes in stereo at 48 kHz, by the command: time over the sound's own, memory."""
    minute = sound(np.ones(5), 48_000, 60.0, 1)
    minute *= 0.1 / minute.std()
    file = write_wav(folder / "long.wav", np.tile(np.stack([minute, minute]), (1, 10)), 48_000, 16)
    call = f"from edge_daemon.cli import main; main(['noise', {str(file)!r}, '--json', {str(folder / 'out.json')!r}])"
    most = "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"
    began = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", f"{call}; {most}"], check=True, capture_output=True, text=True)
    took = time.perf_counter() - began
    mib = float(done.stdout.split()[-1]) / 1024
    size = file.stat().st_size / 2**20
    return [
        Row("WAV of 10 min: time over the sound's", took / 600.0, "1", 0.05, peer=f"{took:.1f} s, start included"),
        Row("WAV of 10 min: memory", mib, "MiB", 256.0, peer=f"the file has {size:.0f} MiB"),
    ]


def of_bursts() -> list[Row]:
    """A second of waveform, averaged and fitted, as the daemon does."""
    hearing = NoiseEstimator(Sound(source="mic", signal="s"))
    value = sound(np.ones(5), 25_600, 20.0, 3)
    times = []
    for i in range(20):
        began = time.process_time()
        hearing.update(Burst("mic", "s", float(i), 25_600.0, value[25_600 * i : 25_600 * (i + 1)]), 100.0)
        times.append(time.process_time() - began)
    return [Row("spectrum and fit of 1 s at 25.6 kHz", 1e3 * float(np.median(times)), "ms", 4.0)]


def by_ear() -> list[Row]:
    """The motor angle from its order 8 at 127 Hz, amplitude 1, in noise of a given density; and the stiffness."""
    rows = []
    joint = rig.Joint(stiffness=STIFFNESS, inertia=0.3, damping=15.0, kinematic_pp=1e-4, out_bits=24)
    for level in (1e-7, 1e-5, 3e-4):
        theta_in, theta_out = ear.motor_and_output(joint, 20.0, 1)
        motor = ear.listener(level)
        heard = ear.sound_of(theta_in, level, np.random.default_rng(2))
        began = time.perf_counter()
        parts = list(ear.heard(motor, joint, theta_out, heard))
        took = time.perf_counter() - began
        angle = np.concatenate([block.values["theta_in_rad"] for block in parts])
        error = (angle - theta_in[: len(angle)])[4000:]
        band = np.fft.rfft(error - error.mean())[20 : 20 + int(40 * len(error) / 1000)]
        seen = math.sqrt(float(np.mean(np.abs(band) ** 2)) / len(error))
        least = math.sqrt(level * 1000.0 * float(np.mean(ear.colour(np.linspace(77, 177, 50))))) / 8
        snr = f"line over noise in 1 Hz: {10 * math.log10(0.5 / (level * 2.9)):.0f} dB"
        rows += [
            Row(f"angle by ear, noise {level:g}: error over Cramer-Rao", seen / least, "1", 1.15, peer=snr),
            Row(f"angle by ear, noise {level:g}: error over stated sd", seen / motor.sd_rad, "1", 1.15),
        ]
    rows.append(
        Row("angle by ear: times real time", 20.0 / took, "1", 20.0, True, peer="sound at 25.6 kHz, made apart")
    )
    return [*rows, *_stiffness_by_ear(joint)]


def _stiffness_by_ear(joint: rig.Joint) -> list[Row]:
    scores, spreads, refused = [], [], 0
    for seed in range(8):
        row = _heard_stiffness(joint, 3e-7, seed)
        if row.status is Status.VALID:
            scores.append((row.value - STIFFNESS) / row.sd)
            spreads.append(row.sd / STIFFNESS)
    for level in (1e-4, 1e-3):
        refused += _heard_stiffness(joint, level, 1).status is not Status.VALID
    return [
        Row("stiffness by ear in 40 s: answers", len(scores), "of 8", 7.0, True, peer="0.7 mrad of motor a sample"),
        Row("stiffness by ear: stated sd, median", 100 * float(np.median(spreads)), "%"),
        Row("stiffness by ear: rms of error over sd", float(np.sqrt(np.mean(np.square(scores)))), "1", 1.7),
        Row("no stiffness where the noise drowns it", float(refused), "of 2", 2.0, True),
    ]


def _heard_stiffness(joint: rig.Joint, level: float, seed: int):
    theta_in, theta_out = ear.motor_and_output(joint, 40.0, seed)
    motor = ear.listener(level)
    out = ChannelSettings(channel="theta_out_rad", source="c", signal="o", counts_per_turn=2**24)
    settings = Estimation(warm_up_s=5.0, cutoff_hz=50.0, stiffness_drift_per_h=1e-6)
    drive = Drive(name="j", modbus_device_id=1, model="m", channels=(out,), estimation=settings)
    estimator = DriveEstimator(drive, rig.model_of(joint))
    rows = ()
    for block in ear.heard(motor, joint, theta_out, ear.sound_of(theta_in, level, np.random.default_rng(seed))):
        estimator.heard_motor(motor.sd_rad)
        rows = estimator.update(block)
    return next(row for row in rows if row.name == "stiffness")


GEARS = {
    "plain": (),
    "viscous and Coulomb at the output": (Influence(twist=law(steps.OUTPUT_FRICTION, 1.0, 0.5)),),
    "LuGre": (Influence(twist=law(steps.LUGRE, 0.5, 0.8, 5e-3, 2e4, 5.0)),),
    "Stribeck": (Influence(twist=law(steps.STRIBECK, 2.0, 4.0, 5e-3)),),
    "creeping": (Influence(twist=bench.Creep()),),
}


def three_methods() -> list[Row]:
    """On the rig, moved through canopen: plain, and with effects that depend on speed."""
    rows = []
    for name, influences in GEARS.items():
        rng = np.random.default_rng(18)
        at = bench.JOINT.ratio, bench.JOINT.inertia_kg_m2
        found = [measure("static", *bench.held(rng, *influences), *at)]
        time_s, columns, phase = bench.moved(rng, *influences)
        kept = {key: column[phase == 2] for key, column in columns.items()}
        found += [measure(method, time_s[phase == 2], kept, *at) for method in ("frequency-response", "dynamic")]
        compared = compare_methods(found)
        worst = max(abs(z) for _, _, z in compared.pairs)
        values = ", ".join(f"{row.stiffness_Nm_per_rad:.0f}±{row.sd_Nm_per_rad:.0f}" for row in found)
        limit = {"plain": 3.0, "creeping": 3.0}.get(name, math.nan)
        words = f"{values}: {compared.verdict}"
        rows.append(Row(f"three methods, {name}: largest difference", worst, "sd", limit, name == "creeping", words))
    return rows


def first_article(runs: int) -> list[Row]:
    """On noisy data: which of its coefficients the same fits call identified, and whether their sd is right."""
    a, rng, kept, scores, needed = np.ones(5), np.random.default_rng(4), [], [], []
    for _ in range(runs):
        seen = fit_noise(Spectrum(FREQUENCY, density(a, FREQUENCY) * rng.gamma(100.0, 0.01, 999), 100.0))
        kept.append(seen.identified)
        scores.append((seen.value - a) / seen.sd)
        needed.append(seen.averages_needed)
    share, wants = np.mean(kept, axis=0), np.median(needed, axis=0)
    told = ", ".join(f"a{b} {100 * share[b]:.0f} %" for b in range(5))
    want = ", ".join(f"a{b} {wants[b]:.3g}" for b in (1, 2, 3))
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    return [
        Row("article 1, 100 averages: a2 called identified", 100 * share[2], "%", 40.0, peer=f"{told}; wants {want}"),
        Row("article 1, 100 averages: error over sd, worst", float(spread.max()), "1", 1.15),
        *_polynomial(),
    ]


def _polynomial() -> list[Row]:
    """k1 and k2 of article 1 in a gear of 1e5 N m/rad at 23 bits: two millionths of the torque and less."""
    truth, effects = (-1e3, 5.0), ("linear_stiffness", "viscous_damping", "polynomial_stiffness")
    scores, called, wants = [], 0, math.nan
    for seed in range(12):
        joint = rig.Joint(in_bits=23, out_bits=23, kinematic_pp=1e-12)
        theta_in, theta_out = rig.linear(joint, rig.Path(TONES, SWEEP, seed))
        rng = np.random.default_rng(seed)
        zero = rng.uniform(0, 1, 2)
        columns = {
            "theta_in_rad": rig.quantised(theta_in + zero[0], 23),
            "theta_out_rad": rig.quantised(theta_out + zero[1], 23),
        }
        model = rig.model_of(joint, *effects)
        found = fit([Recording(np.arange(len(theta_in)) / 1000.0, columns)], model).model.effects[2].parameters
        for name, value in zip(("k1", "k2"), truth, strict=True):
            scores.append((found[name].value - value) / found[name].sd)
            called += found[name].identified
        wants = abs(found["k1"].sd / truth[0])
    peer = f"sd of k1 is {wants:.2g} times k1: {3 * wants:.2g} times the twist, or {(3 * wants) ** 2:.2g} times as long"
    return [
        Row("article 1, 23 bits: k1 or k2 called identified", called, "of 24", 1.0, peer=peer),
        Row("article 1, 23 bits: k1, k2: error over sd, rms", float(np.sqrt(np.mean(np.square(scores)))), "1", 1.5),
    ]


def rows(runs: int = RUNS) -> list[Row]:
    """All figures."""
    return [
        *of_spectra(runs),
        *of_articles(runs),
        *of_files(runs),
        *first_article(runs),
        *of_bursts(),
        *by_ear(),
        *three_methods(),
    ]


if __name__ == "__main__":
    print(table(HEAD, map(cells, rows(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS))))
