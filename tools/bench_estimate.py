"""Estimation: cost against scalar filterpy and real time, and statistical efficiency against the Cramer-Rao bound.

.venv/bin/python tools/bench_estimate.py [RUNS]      Monte-Carlo runs, 200 unless told
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter
from padasip.filters import FilterRLS

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import HEAD, Row, cells  # noqa: E402
from bench_shape import cost as shape_cost  # noqa: E402

from edge_daemon.condition.gathering import Gathering  # noqa: E402
from edge_daemon.config.settings import Sound  # noqa: E402
from edge_daemon.motion.noise_level import compress  # noqa: E402
from edge_daemon.records import Burst  # noqa: E402
from edge_daemon.sound.noise_estimator import NoiseEstimator  # noqa: E402
from edge_daemon.sound.noise_model import fit_noise  # noqa: E402
from edge_daemon.sound.noise_steps import terms  # noqa: E402
from edge_daemon.sound.spectrum import Spectrum  # noqa: E402
from edge_daemon.text import table  # noqa: E402
from edge_daemon.track.live import DriveEstimator  # noqa: E402
from edge_daemon.track.recursive import AmplitudeFilter  # noqa: E402
from tests.motion import simulated_joint as rig  # noqa: E402

RUNS = 200
AMPLITUDES = 6
SAMPLES = 100
SEED = 1


def _median_s(call: Callable[[], object], repeats: int) -> float:
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def filter_cost() -> list[Row]:
    """Compressed blocks against scalar updates of the same library on the same data."""
    rng = np.random.default_rng(SEED)
    columns = rng.normal(size=(SAMPLES, AMPLITUDES))
    torque = columns @ np.arange(1.0, AMPLITUDES + 1) + rng.normal(size=SAMPLES)
    filt = AmplitudeFilter(np.zeros(AMPLITUDES), np.full(AMPLITUDES, 100.0), np.zeros(AMPLITUDES))
    scalar = KalmanFilter(dim_x=AMPLITUDES, dim_z=1)

    def one_by_one() -> None:
        for row, value in zip(columns, torque, strict=True):
            scalar.predict()
            scalar.update(np.array([[value]]), H=row[None, :])

    blocked_s = _median_s(lambda: filt.update(compress(columns, torque), 1.0, 0.1), 300) / SAMPLES
    scalar_s = _median_s(one_by_one, 10) / SAMPLES
    peer = FilterRLS(AMPLITUDES, mu=0.999)

    def peer_one_by_one() -> None:
        for row, value in zip(columns, torque, strict=True):
            peer.adapt(value, row)

    peer_s = _median_s(peer_one_by_one, 10) / SAMPLES
    return [
        Row("block filter, 6 amplitudes, a sample", 1e6 * blocked_s, "us", 2.0),
        Row(
            "block filter over scalar filterpy",
            blocked_s / scalar_s,
            "1",
            1 / 20,
            peer=f"filterpy {1e6 * scalar_s:.1f} us",
        ),
        Row("block filter over padasip RLS", blocked_s / peer_s, "1", 1 / 5, peer=f"padasip {1e6 * peer_s:.1f} us"),
    ]


def sound_cost() -> list[Row]:
    """Spectrum and fit of one second of sound."""
    rng = np.random.default_rng(SEED)
    hearing = NoiseEstimator(Sound(source="mic", signal="sound"))
    bursts = [Burst("mic", "sound", float(i), 25_600.0, rng.normal(size=25_600)) for i in range(60)]
    stream = iter(bursts)
    seconds = _median_s(lambda: hearing.update(next(stream), 100.0), 50)
    return [Row("spectrum and fit of 1 s at 25.6 kHz", 1e3 * seconds, "ms", 4.0)]


def whole_cost() -> list[Row]:
    """All block estimates of a drive against the time its data last, and how the cost grows with drives.

    A drive that is settled does more than one that warms up, and a gateway's drives are settled.
    """
    joint, found = rig.Joint(), {}
    warm_up_s, seconds = 15.0, 10.0
    blocks = list(rig.blocks(joint, *rig.linear(joint, rig.Path(seconds=warm_up_s + seconds))))
    settled = next(i for i, block in enumerate(blocks) if block.start_s - blocks[0].start_s > warm_up_s)
    for drives in (1, 10, 50):
        made = range(drives)
        estimators = [(Gathering(), DriveEstimator(rig.drive_settings(joint), rig.model_of(joint))) for _ in made]
        times = [time.process_time()]
        for part in (blocks[:settled], blocks[settled:]):
            for block in part:
                for gathering, estimator in estimators:
                    for gathered in gathering.push(block):
                        estimator.update(gathered)
            times.append(time.process_time())
        found[drives] = (times[2] - times[1]) / (drives * seconds)
        found[-drives] = (times[1] - times[0]) / (drives * warm_up_s)
    return [
        Row("estimation of one settled drive, times real time", 1 / found[1], "x", 200.0, at_least=True),
        Row("estimation of one drive that warms up", 1 / found[-1], "x", 200.0, at_least=True),
        Row("cost per drive, ten over one", found[10] / found[1], "1", 1.3),
        Row("cost per drive, fifty over one", found[50] / found[1], "1", 1.3),
    ]


def noise_efficiency(runs: int) -> list[Row]:
    """RMSE of each noise coefficient over its Cramer-Rao bound; 1000 averages on 999 bins."""
    rng = np.random.default_rng(SEED)
    frequency, averages = np.linspace(10.0, 10_000.0, 999), 1000.0
    columns = terms(frequency, 300.0)
    psd = columns @ np.ones(5)
    rows = columns / psd[:, None]
    bound = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows * averages)))
    drawn = [Spectrum(frequency, psd * rng.gamma(averages, 1 / averages, 999), averages) for _ in range(runs)]
    fits = [fit_noise(spectrum).value for spectrum in drawn]
    ratio = np.sqrt(np.mean((np.array(fits) - 1.0) ** 2, axis=0)) / bound
    limit = 1.05 + 2 / math.sqrt(2 * runs)
    return [
        Row(f"noise a{b}: RMSE over Cramer-Rao", float(r), "1", limit, peer=f"{runs} runs") for b, r in enumerate(ratio)
    ]


def rows(runs: int = RUNS) -> list[Row]:
    """All figures; the Monte-Carlo limits carry two standard deviations of their own chance."""
    return [*filter_cost(), *sound_cost(), *whole_cost(), *shape_cost(), *noise_efficiency(runs)]


if __name__ == "__main__":
    print(table(HEAD, map(cells, rows(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS))))
