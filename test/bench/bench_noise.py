"""Measures the noisy paths of the noise study; scripts/bench.sh noise.

Ten levels of noise, a thousand paths of the simulated square at 20 Hz each, on one core; beside the
per-message loop of NoisyPath over the same messages.
Prints the best of some rounds, as others may be using the machine.
The loop gives each message its covariances; the many paths have them from `exact_moments`, once.
--rounds N. --paths N: at each of the levels.
"""

import os

# Before numpy is loaded: its linear algebra would take all cores.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import time  # noqa: E402

from common import options, report  # noqa: E402

from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps, study_generator  # noqa: E402
from bullet_lab.noise.odometry_noise import NoisyPath  # noqa: E402
from bullet_lab.studies.noise_study.regions import level_rule  # noqa: E402
from bullet_lab.studies.noise_study.study import StudySettings, simulated_square  # noqa: E402
from bullet_lab.studies.paths import resample  # noqa: E402

RATE = 20.0
MODEL = "report"
LEVELS = StudySettings().levels
LOOP_PATHS = 2
MOST_SECONDS, LEAST_FACTOR = 3.0, 100.0


def seconds(work):
    """Return the time of the processor, one core of it, that some work takes."""
    start = time.process_time()
    work()
    return time.process_time() - start


def draw(trajectory, paths):
    """Draw all noisy paths, every pose of them, and look at none."""
    for std in LEVELS:
        steps = noisy_steps(trajectory.poses, level_rule(MODEL, std))
        for _ in noisy_blocks(steps, study_generator(1, MODEL, std, RATE), paths):
            pass


def loop(trajectory):
    """Make some noisy paths message by message, with covariances, as noisy_odom does."""
    poses = trajectory.poses.tolist()
    for std in LEVELS:
        path = NoisyPath(level_rule(MODEL, std), 1)
        for _ in range(LOOP_PATHS):
            path.restart()
            for pose in poses:
                path.update(*pose)


def main():
    """Measure all in turns, print and write."""
    wanted = options(__doc__, rounds=5, paths=1000)
    trajectory = resample(simulated_square(), RATE)
    steps = len(LEVELS) * wanted.paths * (len(trajectory) - 1)
    loop_steps = len(LEVELS) * LOOP_PATHS * (len(trajectory) - 1)
    drawn, looped = [], []
    for number in range(wanted.rounds):
        drawn.append(seconds(lambda: draw(trajectory, wanted.paths)))
        looped.append(seconds(lambda: loop(trajectory)) / loop_steps)
        print(
            f"round {number + 1} of {wanted.rounds}: {drawn[-1]:.2f} s to draw; "
            f"the loop takes {1e6 * looped[-1]:.1f} us a message"
        )
    share = steps * min(looped) / min(drawn)
    rows = [
        ("paths drawn, s", min(drawn), ".2f", f"<= {MOST_SECONDS:g}"),
        ("times as fast as the loop", share, ".0f", f">= {LEAST_FACTOR:g}"),
    ]
    report(wanted.out, rows, f"{steps} steps", draw_s=drawn, loop_s_per_message=looped)


if __name__ == "__main__":
    main()
