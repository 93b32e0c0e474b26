"""Draws our learning curves beside those of `peer_curves.py`: median of the seeds, with the smallest and the largest.

    cargo shield run examples/learners/inverted-pendulum.ron
    cargo shield run examples/learners/half-cheetah.ron
    python examples/learners/plot_curves.py runs examples/learners/curves

The second folder holds `stable-baselines3.csv`; `shield.csv` and `curves.png` are written into it.
"""

import csv
import pathlib
import statistics
import sys

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

ENVIRONMENTS = {"inverted-pendulum": "InvertedPendulum-v5", "half-cheetah": "HalfCheetah-v5"}
COLUMNS = ["learner", "environment", "seed", "step", "mean_return"]


def ours(runs):
    """The evaluations of our runs, as rows of the other file."""
    for experiment, environment in ENVIRONMENTS.items():
        for path in sorted((runs / experiment).glob("*/seed-*/evaluations.csv")):
            learner, seed = path.parts[-3], path.parts[-2].removeprefix("seed-")
            with path.open(newline="") as file:
                for row in csv.DictReader(file):
                    yield [learner, environment, seed, row["step"], row["mean_return"]]


def curve(rows, learner, environment):
    """Steps, and for each the sorted returns of the seeds."""
    points = {}
    for row in rows:
        if (row["learner"], row["environment"]) == (learner, environment):
            points.setdefault(int(row["step"]), []).append(float(row["mean_return"]))
    return [(step, sorted(points[step])) for step in sorted(points)]


def main(runs, folder):
    with (folder / "shield.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(ours(runs))
    figure, axes = pyplot.subplots(1, len(ENVIRONMENTS), figsize=(11, 4))
    for axis, environment in zip(axes, ENVIRONMENTS.values()):
        for name, style in (("shield", "-"), ("stable-baselines3", "--")):
            with (folder / f"{name}.csv").open(newline="") as file:
                rows = list(csv.DictReader(file))
            for learner, colour in (("td3", "tab:blue"), ("ddpg", "tab:orange")):
                points = curve(rows, learner, environment)
                steps = [step for step, _ in points]
                middle = [statistics.median(returns) for _, returns in points]
                axis.plot(steps, middle, style, color=colour, label=f"{learner}, {name}")
                low, high = ([returns[end] for _, returns in points] for end in (0, -1))
                axis.fill_between(steps, low, high, color=colour, alpha=0.1)
        axis.set(title=environment, xlabel="environment steps", ylabel="mean return of five greedy episodes")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(folder / "curves.png", dpi=110)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
