"""What a detector makes of road users by place, by company and by kind: does it know the shape, or
the place?

    python tests/benchmarks/models/bench_place.py [--site tjunction] [--weights tjunction] [--frames
        60] [--seed 31001]

Each frame has some ten single road users or groups, far from each other, at any heading on lanes or
on footways, seen by the site's sensors with the paper's noise. Of those with twenty points and more
a line says how many were found as what they are (IoU from which a detection is true), how many were
found as another class alone, and how many not at all.
"""

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

FEWEST_POINTS = 20
APART, MOST = 9.0, 12  # m between groups, and their number in a frame
GROUPS = {  # kinds that stand side by side, and the air between them (m)
    "adult": (("adult",), 0.0),
    "child": (("child",), 0.0),
    "pram": (("pram",), 0.0),
    "wheelchair": (("wheelchair",), 0.0),
    "pair 0.1 m apart": (("adult", "adult"), 0.1),
    "pair 0.4 m apart": (("adult", "adult"), 0.4),
    "adult and child": (("adult", "child"), 0.15),
    "four adults": (("adult",) * 4, 0.15),
    "bicycle": (("bicycle",), 0.0),
    "e_scooter": (("e_scooter",), 0.0),
    "pair of bicycles": (("bicycle", "bicycle"), 0.3),
    "motorcycle": (("motorcycle",), 0.0),
}


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--site", default="tjunction")
    arguments.add_argument("--weights", default="tjunction")
    arguments.add_argument("--frames", type=int, default=60)
    arguments.add_argument("--seed", type=int, default=31001)
    asked = arguments.parse_args()

    import shapely

    from models import load_detector
    from toolkit.bodies.drawn_bodies import draw_body
    from toolkit.boxes import count_points, iou_3d
    from toolkit.datasets.recording_views import with_errors
    from toolkit.detection.metrics import TRUE_IOU
    from toolkit.frame import Frame
    from toolkit.objects import CYCLIST, PEDESTRIAN, Objects
    from toolkit.points import detect_on_ground, frame_points
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.files import load_site
    from toolkit.sites.network import unite
    from toolkit.traffic.obstacles import Obstacles
    from toolkit.traffic.snapshots import Snapshot

    site, rng = load_site(asked.site), np.random.default_rng(asked.seed)
    area = site.area if asked.weights == "general" else None
    detect, obstacles = load_detector(asked.weights, area=area), Obstacles(site)
    inner = shapely.box(*site.area).buffer(-3)
    grounds = {
        "lane": unite(site.lanes).intersection(inner),
        "footway": unite(site.footways).intersection(inner),
    }

    def draw(kind: str):
        label = PEDESTRIAN if kind in ("adult", "child", "pram", "wheelchair") else CYCLIST
        while True:
            body = draw_body(label, rng, evenly=True)
            if body.name.rpartition("/")[2] == kind:
                return body

    def place(bodies: list, gap: float, x: float, y: float) -> np.ndarray | None:
        yaw, across, rows = rng.uniform(-np.pi, np.pi), 0.0, []
        for body in bodies:
            across += body.size[1] / 2
            at = x - across * np.sin(yaw), y + across * np.cos(yaw)
            rows.append([*at, body.size[2] / 2, *body.size, yaw])
            across += body.size[1] / 2 + gap
        boxes = np.array(rows)
        return None if obstacles.hit(boxes).any() else boxes

    counts = defaultdict(lambda: np.zeros(4, int))  # seen, found, another class, none
    for number in range(asked.frames):
        bodies, boxes, names, taken = [], [], [], []
        for _ in range(400):
            where, group = (
                ("lane", "footway")[rng.integers(2)],
                list(GROUPS)[rng.integers(len(GROUPS))],
            )
            kinds, gap = GROUPS[group]
            x, y = rng.uniform(site.area[:2], site.area[2:])
            close = any(np.hypot(x - a, y - b) < APART for a, b in taken)
            if close or len(taken) == MOST or not grounds[where].contains(shapely.Point(x, y)):
                continue
            drawn = [draw(kind) for kind in kinds]
            placed = place(drawn, gap, x, y)
            if placed is not None:
                taken.append((x, y))
                bodies += drawn
                boxes.append(placed)
                names += [(group, where)] * len(drawn)
        rows = np.concatenate(boxes)
        rows[:, 2] += site.ground(rows[:, :2])
        labels = np.array([body.label for body in bodies])
        objects = Objects(rows, labels, np.arange(len(rows)))
        renderer = Renderer(site, tuple(bodies), site.sensors, threads=1)
        images = renderer.render(Snapshot(objects, np.arange(len(rows)))).measurements
        frame = Frame(site.sensors, images, objects, 0.0, number)
        cloud = np.concatenate(frame_points(with_errors(frame, "paper", 0), area=site))
        found = detect_on_ground(detect, cloud, site)
        points, overlap = count_points(cloud, rows), iou_3d(found.boxes, rows)
        for k, name in enumerate(names):
            if points[k] < FEWEST_POINTS:
                continue
            near = overlap[:, k] >= TRUE_IOU[labels[k]]
            right = (near & (found.labels == labels[k])).any()
            wrong = (overlap[:, k] >= 0.1) & (found.labels != labels[k])
            counts[name] += [1, right, not right and wrong.any(), not right and not wrong.any()]
    print(
        f"{'group':>18s} {'place':>8s} {'seen':>5s} {'found':>6s} {'as another':>10s} "
        f"{'missed':>7s}"
    )
    for (group, where), (seen, right, wrong, none) in sorted(counts.items()):
        print(
            f"{group:>18s} {where:>8s} {seen:5d} {right / seen:6.3f} {wrong / seen:10.3f} "
            f"{none / seen:7.3f}"
        )


if __name__ == "__main__":
    main()
