"""Tables 3 and 4: gain of a second sensor in a shared region, and other methods' figures.

In a region, both sensors of a pair have a vehicle's centre in their field of view, occluded or
not."""

from collections.abc import Mapping
from functools import partial

from examples.studies.paper.charts import draw_pairs
from examples.studies.paper.comparison import Compared, Experiment
from examples.studies.paper.detections import SchemeRun, StoredDetections, compare_run, score_run
from examples.studies.paper.paper_rows import SensorSet, set_name
from examples.studies.paper.paper_tables import (
    BENCHMARK_PAIR,
    BENCHMARK_TABLE,
    PLACE_NAMES,
    REGION_TABLE,
)


def region_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 3: gain of a second sensor that has the same region in view.

    site: one of the paper's sites; basis: words for the data behind our figures."""
    rows = []
    names = []
    our_ap: dict[tuple[SensorSet, SensorSet], float] = {}
    paper_ap: dict[tuple[SensorSet, SensorSet], float] = {}
    for row in REGION_TABLE[site]:
        labels = (f"in view of {set_name(row.region)}, {{}} vehicles", set_name(row.sensors))
        run = SchemeRun("early", row.sensors)
        compared = compare_run(stored, run, labels, row.ap, region=row.region)
        rows.append(compared)
        names.append(f"{set_name(row.sensors)}\nin {set_name(row.region)}")
        our_ap[row.region, row.sensors] = compared.ours or 0.0
        paper_ap[row.region, row.sensors] = row.ap
    gain_texts = []
    gains = []
    for pair in dict.fromkeys(row.region for row in REGION_TABLE[site]):
        gain = _find_gain(our_ap, pair)
        gains.append(gain)
        gain_texts.append(
            f"{set_name(pair)} together {gain:+.3f} over the better of the two (paper "
            f"{_find_gain(paper_ap, pair):+.3f})"
        )
    gain_note = "Not every pair is better than the better of its two sensors."
    if all(gain > 0 for gain in gains):
        gain_note = "A second view of the same place helps at both pairs, as in the paper."
    title = f"Shared regions, {PLACE_NAMES[site]}, early fusion, IoU 0.7, {stored.frames} frames"
    return Experiment(
        "shared_regions",
        "Spatial diversity in shared regions",
        "table 3, section IV-D",
        ("region", "sensors"),
        tuple(rows),
        f"{basis}; vehicles whose centre both sensors of the pair have in their field of view",
        f"{gain_note} In AP, {'; '.join(gain_texts)}.",
        partial(draw_pairs, names, rows, title=title),
    )


def _find_gain(ap: Mapping[tuple[SensorSet, SensorSet], float], pair: SensorSet) -> float:
    """Return the AP that a pair adds to the better of its two sensors.

    ap: AP by region (a pair) and fused sensors; pair: both sensors, and the region."""
    return ap[pair, pair] - max(ap[pair, pair[:1]], ap[pair, pair[1:]])


def benchmark_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 4: the paper's figures, other methods', and ours for the same pair.

    site: one of the paper's sites; basis: words for the data behind our figures."""
    pair = BENCHMARK_PAIR[site]
    paper = {row.sensors: row.ap for row in REGION_TABLE[site] if row.region == pair}
    rows = []
    for method in BENCHMARK_TABLE:
        rows += [Compared((method.method, "one sensor"), "AP", None, ap) for ap in method.single]
        if method.two is not None:
            rows.append(Compared((method.method, "two sensors"), "AP", None, method.two))
    for sensors, count in ((pair[:1], "one sensor"), (pair, "two sensors")):
        labels = (f"ours, early fusion, {set_name(sensors)} in view of {set_name(pair)}", count)
        run = SchemeRun("early", sensors)
        rows.append(compare_run(stored, run, labels, paper[sensors], region=pair))
    gain = (rows[-1].ours or 0.0) - (rows[-2].ours or 0.0)
    paper_gain = paper[pair] - paper[pair[:1]]
    one_sensor = score_run(stored, SchemeRun("early", pair[:1]), region=pair[:1])
    labels = (f"ours, sensor {pair[0]}, vehicles in its field of view", "one sensor")
    rows.append(Compared(labels, "AP", one_sensor.ap, None, one_sensor.interval))
    title = f"Reported figures and ours, {PLACE_NAMES[site]}, {stored.frames} frames"
    names = [f"{row.labels[0].split(',')[0]}\n{row.labels[1]}" for row in rows]
    conclusion = (
        "Other data, other sensors: only the gain from a second sensor can be compared. "
        f"It is {gain:+.2f} here, {paper_gain:+.2f} in the paper and +0.53 for Cooper and F-Cooper."
    )
    if site != "tjunction":
        conclusion += " The paper's table 4 covers the T-junction alone."
    return Experiment(
        "benchmarks",
        "Comparison with existing benchmarks",
        "table 4, section IV-F",
        ("method", "sensors"),
        tuple(rows),
        f"{basis}; rows without ours are from other authors and data, as the paper reports them",
        conclusion,
        partial(draw_pairs, names, rows, title=title),
    )
