"""Plan roadside perception: decide what to build at a junction, and see what it will see.

The names below are all that most programs need; nothing loads before it is used. More is in the
faces of the floors, `toolkit`, `models` and `placement_env`.

>>> from coview import load_site
>>> load_site("tjunction").name
'tjunction'
"""

from typing import TYPE_CHECKING, Any

# isort: off
if TYPE_CHECKING:
    import gymnasium
    import coview.live_start

    from coview.detectors import load_detector as load_detector
    from placement_env import (
        Objective as Objective,
        Question as Question,
        Result as Result,
        Setting as Setting,
        Weights as Weights,
        as_sb3 as as_sb3,
        plan as plan,
    )
    from toolkit import (
        Detections as Detections,
        Objects as Objects,
        Renderer as Renderer,
        Run as Run,
        catalogue as catalogue,
        crop as crop,
        down_sample as down_sample,
        evaluate_recording as evaluate_recording,
        from_depth as from_depth,
        fuse as fuse,
        fuse_files as fuse_files,
        load_site as load_site,
        open_recording as open_recording,
        points_per_box as points_per_box,
        save_site as save_site,
        sensor_numbers as sensor_numbers,
        simulate as simulate,
    )

    __version__: str
else:
    _FACES = {
        "coview.detectors": ("load_detector",),
        "placement_env": (
            "Objective",
            "Question",
            "Result",
            "Setting",
            "Weights",
            "as_sb3",
            "plan",
        ),
        "toolkit": (
            "Detections",
            "Objects",
            "Renderer",
            "Run",
            "catalogue",
            "crop",
            "down_sample",
            "evaluate_recording",
            "from_depth",
            "fuse",
            "fuse_files",
            "load_site",
            "open_recording",
            "points_per_box",
            "save_site",
            "sensor_numbers",
            "simulate",
        ),
    }
    _HOMES: dict[str, str] = {}
    for _face, _names in _FACES.items():
        _HOMES.update(dict.fromkeys(_names, _face))
    __all__ = ["live", "make", "search", *sorted(_HOMES)]

    def __getattr__(name: str) -> object:
        """Import a name of the face when it is first used, so that importing coview stays quick."""
        from importlib import import_module
        from importlib.metadata import PackageNotFoundError, version

        if name == "__version__":
            try:
                return version("coview")
            except PackageNotFoundError:  # a checkout that is not installed
                return "0+unknown"
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from coview.main import refuse_hidden_packages

        try:
            refuse_hidden_packages()
        except ValueError as error:
            raise ImportError(str(error)) from None
        return getattr(import_module(_HOMES[name]), name)

    def __dir__() -> list[str]:
        return ["__version__", *__all__]


def search(
    objective: "Objective",
    budget: int,
    *,
    method: str = "portfolio",
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
) -> "Result":
    """Search for the best set of at most `budget` sensors.

    method: portfolio, exhaustive, greedy, swap, cpsat or another of `placement_env.search`;
    seconds, evaluations: limits, None for the method's default. Raises ValueError for a method that
    cannot search this objective, ImportError if its package is missing."""
    from placement_env.search.methods import METHODS, load_search

    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    return load_search(method)(
        objective, budget, seed=seed, seconds=seconds, evaluations=evaluations
    )


def make(name: str = "SensorSelect", **settings: Any) -> "gymnasium.Env[Any, Any]":
    """Make an environment: SensorSelect, SensorSubset or SensorPose.

    settings: fields of its configuration, such as site="tjunction" and budget=3. Raises
    ImportError without Gymnasium."""
    try:
        import gymnasium
    except ImportError:
        raise ImportError("the environments need Gymnasium: pip install coview[rl]") from None

    return gymnasium.make(f"placement_env:coview/{name}-v0", **settings)


def live(
    site: "Setting | str", *, frames: int | None = None, seed: int | None = None, port: int = 8090
) -> "coview.live_start.LiveSession":
    """Serve a page on which sensors of a site, a setting or a plan's folder are moved by hand.

    In Jupyter the page is shown in the cell. frames, seed: number of frames and seed of the
    traffic; by default the plan's, or 60 and 3. Raises ValueError if no surrogate scores the
    setting, OSError for a plan whose detector is gone, ImportError without viser."""
    from dataclasses import replace

    from coview.live_start import LiveSession
    from coview.options import load_own_detector
    from placement_env.live.planner import LivePlanner
    from placement_env.report.planning.plan_folder import is_plan_folder, read_plan_folder
    from toolkit.runtime.run import Run

    if not is_plan_folder(site):
        return LiveSession(LivePlanner(site, frames, seed), port=port)
    plan = read_plan_folder(str(site))
    detector = load_own_detector(plan.own_detector, plan.setting.place, Run())
    question = plan.ask(replace(plan.setting, detector=detector))
    return LiveSession(LivePlanner(question, frames, seed), port=port)
