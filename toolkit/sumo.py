"""SUMO inside this process: one simulation at a time, silent, its complaints raised as exceptions."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

STEP = 1.0  # s; SUMO's own default, for which its driver models are tuned
LATERAL_RESOLUTION = 0.8  # m; sublanes: cars leave the lane's middle, two-wheelers ride beside each other


@contextmanager
def running(network: str, types: str, *, seed: int) -> Iterator[Any]:
    """The libsumo module while it simulates the network (net.xml text) with the vehicle types (additional-file text).

    Raises ImportError where SUMO is not installed, RuntimeError where a simulation is open in this process already
    (libsumo knows only one), ValueError with SUMO's own words where it refuses the network.
    """
    sumo = load_sumo()
    if sumo.simulation.isLoaded():
        raise RuntimeError(
            "SUMO simulates one site at a time in a process, and one is open: "
            "use up or close() the earlier simulation first, or run this one in another process"
        )
    with TemporaryDirectory(prefix="coview-") as folder:
        files = {name: Path(folder) / name for name in ("net.xml", "types.xml", "errors.txt")}
        files["net.xml"].write_text(network, encoding="utf-8")
        files["types.xml"].write_text(types, encoding="utf-8")
        try:
            sumo.start(["sumo", *_options(files, seed)])
        except Exception as error:  # SUMO says why only in its log
            said = files["errors.txt"].read_text(encoding="utf-8").strip() if files["errors.txt"].exists() else ""
            reason = said.splitlines()[0].removeprefix("Error: ") if said else str(error)
            raise ValueError(f"SUMO refuses the site's network: {reason}: build it again with netconvert") from None
    try:
        yield sumo
    finally:
        sumo.close()


def load_sumo() -> Any:
    """The libsumo module, or ImportError that says how to install it."""
    try:
        with redirect_stdout(io.StringIO()):  # it greets with a warning about pyarrow, which is not used here
            return import_module("libsumo")
    except ImportError as error:
        raise ImportError(f'traffic needs SUMO ({error}): pip install "coview[sim]"') from None


def _options(files: dict[str, Path], seed: int) -> list[str]:
    options = {
        "net-file": files["net.xml"],
        "additional-files": files["types.xml"],
        "error-log": files["errors.txt"],
        "seed": seed,
        "step-length": STEP,
        "lateral-resolution": LATERAL_RESOLUTION,
        "collision.action": "none",
        "time-to-teleport": -1,
        "max-depart-delay": 0,
        "xml-validation": "never",
        "xml-validation.net": "never",
        "no-step-log": "true",
        "no-warnings": "true",
        "duration-log.disable": "true",
    }
    return [word for name, value in options.items() for word in (f"--{name}", str(value))]
