"""The published network as published, ours of the same size, and the light one, from a fused cloud
to boxes.

    python tests/benchmarks/models/bench_voxelnet.py [threads]

Milliseconds (best and median of some rounds, and of processor time the best) and peak memory, each
network in a process of its own, on two threads. The weights are random, and let 600 anchors pass
the threshold. On a busy machine compare processor times on one thread.
"""

import resource
import subprocess
import sys
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

# x y heading of the T-junction's six sensors, and footprints (xmin ymin xmax ymax, height) of what
# stands around it
SENSORS = (
    (40.9, 8.1, 155),
    (-7.7, 21.9, 295),
    (-45.6, 10.1, 15),
    (8.0, 5.6, 52),
    (-8.3, 18.5, 208),
    (-5.5, -27.5, 64),
)
SOLIDS = (
    *((-38.6, -4.5, -27.7, 5.9, 4), (-26.5, -6.2, -14.7, 6.2, 5), (-26.5, -17.4, -14.7, -6.2, 8)),
    *(
        (-49, -29, -28, -4.8, 12),
        (-28.8, -29, -19, -19.4, 8),
        (-40, 21, 40, 24, 6),
        (36, -19, 40, 5, 3),
    ),
)


def fused_cloud(seed: int = 0) -> np.ndarray:
    """About 76,000 points (n, 3) float32 that six depth cameras would see of a T-junction with 30
    cars, site frame."""
    rng = np.random.default_rng(seed)
    boxes = np.array([*SOLIDS, *(_car(rng) for _ in range(30))])
    clouds = [_seen(np.array([x, y, 5.2]), np.radians(heading), boxes) for x, y, heading in SENSORS]
    points = np.concatenate(clouds)
    points += rng.normal([0, 0, 0.03], 0.02, points.shape)
    inside = (
        (np.abs(points[:, 0]) < 40)
        & (np.abs(points[:, 1]) < 20)
        & (points[:, 2] > 0)
        & (points[:, 2] < 4)
    )
    return points[inside].astype(np.float32)


def _car(rng: np.random.Generator) -> tuple[float, ...]:
    if rng.random() < 0.7:
        x, y, half = rng.uniform(-38, 38), rng.choice([11.6, 15.6]) + rng.normal(0, 0.3), (2.1, 0.9)
    else:
        x, y, half = rng.choice([-2.8, 1.2]) + rng.normal(0, 0.3), rng.uniform(-18, 6), (0.9, 2.1)
    return x - half[0], y - half[1], x + half[0], y + half[1], 1.5


def _seen(eye: np.ndarray, heading: float, boxes: np.ndarray, tilt: float = 0.2) -> np.ndarray:
    """Where 200 x 150 rays first meet the ground or a box."""
    u, v = np.meshgrid((np.arange(200) - 99.5) / 100, (np.arange(150) - 74.5) / 100)
    forward, up = np.cos(tilt) - v * np.sin(tilt), -np.sin(tilt) - v * np.cos(tilt)
    ray = np.stack(
        (
            forward * np.cos(heading) + u * np.sin(heading),
            forward * np.sin(heading) - u * np.cos(heading),
            up,
        )
    )
    ray = ray.reshape(3, -1).T + 1e-12
    distance = np.where(ray[:, 2] < 0, -eye[2] / ray[:, 2], 200.0)
    for xmin, ymin, xmax, ymax, top in boxes:
        lower, upper = (
            (np.array([xmin, ymin, 0]) - eye) / ray,
            (np.array([xmax, ymax, top]) - eye) / ray,
        )
        near, far = np.minimum(lower, upper).max(1), np.maximum(lower, upper).min(1)
        hit = (near < far) & (near > 0) & (near < distance)
        distance[hit] = near[hit]
    return eye + distance[:, None] * ray


def published_as_published() -> None:
    """Padded voxels, every cell of the grid, BatchNorm unfolded: the slow reference of the
    tests."""
    import torch

    sys.path.insert(0, str(Path(__file__).parents[2] / "models"))
    from test_published import padded_voxels, random_network

    points = fused_cloud()
    carla = np.stack((104 - points[:, 1], points[:, 0] - 196, points[:, 2]), 1)
    reference, inputs = random_network(), padded_voxels(carla, "tjunction")
    with torch.inference_mode():
        _report("published, dense, voxels given", lambda: reference(*inputs), rounds=4)
    _report("    its voxelisation in Python", lambda: padded_voxels(carla, "tjunction"), rounds=2)


def ours_of_the_same_size() -> None:
    """`SparseVoxelNet` with the same weights and the same outputs, points to maps, and points to
    boxes."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "models"))
    from dataclasses import replace

    from test_published import random_network

    from models.config import VoxelNetConfig
    from models.network.voxelnet import VoxelNet
    from models.published import AREA, PublishedDetector, from_published

    network = VoxelNet(replace(VoxelNetConfig.from_paper("tjunction"), area=AREA["tjunction"]))
    network.load_state_dict(
        from_published(random_network().state_dict(), network, "random weights")
    )
    detector, points = PublishedDetector(_selective(network).eval(), "tjunction"), fused_cloud()
    _report("same size, points to raw maps", lambda: detector.head(points), rounds=5)
    _report("same size, points to boxes", lambda: detector(points), rounds=5)


def light() -> None:
    """The CPU default with its shipped weights, points to boxes, and where its time goes."""
    from models.detector_loading import load_detector
    from models.network.candidates import candidates, suppress_boxes
    from models.network.grid import voxelise

    detector, points = load_detector("tjunction"), fused_cloud()
    config = detector.config
    voxels = voxelise(points, config)
    maps = detector.network(voxels)
    boxes = candidates(maps, detector.anchors, config, detector.thresholds)[0]
    counts = len(points), len(voxels.cells), len(boxes[0]), len(detector(points))
    print("    {} points, {} voxels, {} candidates, {} boxes".format(*counts))
    _report("light, points to boxes", lambda: detector(points), rounds=50)
    _report("    voxelisation", lambda: voxelise(points, config), rounds=50)
    _report("    network", lambda: detector.network(voxels), rounds=50)
    _report(
        "    decoding",
        lambda: candidates(maps, detector.anchors, config, detector.thresholds),
        rounds=50,
    )
    _report("    suppression", lambda: suppress_boxes(*boxes, config, 0.1), rounds=50)
    quick = detector.quick()  # as plans, searches and `evaluate` use it
    _report(f"light, in {quick.numbers}", lambda: quick(points), rounds=50)


def voxelisation() -> None:
    from models.config import VoxelNetConfig
    from models.network.grid import voxelise

    points = np.concatenate((fused_cloud(0), fused_cloud(1)))[-80_000:]
    config = VoxelNetConfig.from_paper("tjunction")
    _report("voxelisation of 80,000 points", lambda: voxelise(points, config), rounds=50)


def _selective(network):
    """Let the 600 best of the anchors pass the threshold, on the benchmark's cloud."""
    import torch

    from models.network.candidates import candidates
    from models.network.grid import anchors, voxelise
    from models.network.sparse import SparseVoxelNet

    if network.head.quality is not None:
        network.head.quality.bias.data += 9.0
    maps = SparseVoxelNet(network)(voxelise(fused_cloud(), network.config))
    ((_, scores),) = candidates(maps, anchors(network.config), network.config, (0.0,))
    unsure = torch.logit(torch.topk(scores.flatten(), 600).values[-1]) + np.log(9)
    network.head.classes.bias.data[network.config.classes - 1 :: network.config.classes] -= unsure
    return network


def _report(name, call, *, rounds):
    call()
    times, processor = [], []
    for _ in range(rounds):
        start = perf_counter(), process_time()
        call()
        times.append((perf_counter() - start[0]) * 1e3)
        processor.append((process_time() - start[1]) * 1e3)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    best, median, busy = min(times), sorted(times)[rounds // 2], min(processor)
    print(
        (
            f"{name:34s} {best:8.1f} ms (median {median:.1f}, processor {busy:.1f})   peak "
            f"{peak:5.0f} MB"
        ),
        flush=True,
    )


CASES = (published_as_published, ours_of_the_same_size, light, voxelisation)

if __name__ == "__main__":
    if len(sys.argv) < 3:
        for number in range(len(CASES)):
            subprocess.run(
                [sys.executable, __file__, *(sys.argv[1:] or ["2"]), str(number)], check=True
            )
    else:
        import torch

        sys.path.insert(0, str(Path(__file__).parents[3]))
        torch.set_num_threads(int(sys.argv[1]))
        CASES[int(sys.argv[2])]()
