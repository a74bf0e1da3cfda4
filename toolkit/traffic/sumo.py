"""SUMO in this process: one simulation at a time, silent, its errors raised."""

import io
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

STEP_S = 1.0  # s; SUMO's own default, for which its driver models are tuned
FINE_STEP_S = 0.1  # s, for continuous traffic
# m; sublanes: cars leave the lane's middle, two-wheelers ride next to each other
LATERAL_RESOLUTION = 0.8
# SUMO's command line options without the leading "--"; collisions change nothing, nothing
# teleports, and what cannot depart when it is due is dropped
_OPTIONS = {
    "lateral-resolution": LATERAL_RESOLUTION,
    "collision.action": "none",
    "time-to-teleport": -1,
    "max-depart-delay": 0,
    **dict.fromkeys(("xml-validation", "xml-validation.net"), "never"),
    **dict.fromkeys(("no-step-log", "no-warnings", "duration-log.disable"), "true"),
}


@contextmanager
def running(
    network: str,
    types: str,
    *,
    seed: int,
    step: float = STEP_S,
    options: Mapping[str, float] | None = None,
) -> Iterator[ModuleType]:
    """Start a simulation and yield the libsumo module that runs it; close it at the end.

    Args:
        network: text of the network (net.xml).
        types: text of the additional file with the vehicle types.
        seed: seed of SUMO's random numbers.
        step: time step (s).
        options: further options of SUMO by name, without the leading "--".

    Raises ImportError without SUMO, RuntimeError if a simulation is open in this process already
    (libsumo knows only one), ValueError with SUMO's words if it refuses the network."""
    try:
        # it greets with a warning about pyarrow, which is not used here
        with redirect_stdout(io.StringIO()):
            sumo = import_module("libsumo")
    except ImportError as error:
        raise ImportError(f'traffic needs SUMO ({error}): pip install "coview[sim]"') from None
    if sumo.simulation.isLoaded():
        raise RuntimeError(
            "SUMO simulates one site at a time in a process, and one is open: "
            "use up or close() the earlier simulation first, or run this one in another process"
        )
    with TemporaryDirectory(prefix="coview-") as folder:
        files = {name: Path(folder) / name for name in ("net.xml", "types.xml", "said.txt")}
        files["net.xml"].write_text(network, encoding="utf-8")
        files["types.xml"].write_text(types, encoding="utf-8")
        all_options = {
            **_OPTIONS,
            "net-file": files["net.xml"],
            "additional-files": files["types.xml"],
            "seed": seed,
            "step-length": step,
        }
        all_options |= options or {}
        command = ["sumo"]
        for name, value in all_options.items():
            command += [f"--{name}", str(value)]
        try:
            with _stderr_into(files["said.txt"]):
                sumo.start(command)
        except Exception as error:  # SUMO says why only on stderr
            message = files["said.txt"].read_text(encoding="utf-8").strip() or str(error)
            reason = message.splitlines()[0].removeprefix("Error: ").rstrip(".")
            raise ValueError(
                f"SUMO refuses the site's network: {reason}: build it again with netconvert"
            ) from None
    try:
        yield sumo
    finally:
        sumo.close()


def find_standing(sumo: ModuleType, min_standing_s: float) -> dict[str, str]:
    """SUMO's lane of each vehicle that has stood for at least so many seconds, by its name.

    sumo: libsumo module with a running simulation."""
    vehicles = sumo.vehicle
    return {
        name: vehicles.getLaneID(name)
        for name in vehicles.getIDList()
        if vehicles.getWaitingTime(name) >= min_standing_s
    }


@contextmanager
def _stderr_into(file: Path) -> Iterator[None]:
    """Redirect stderr of the whole process, C++ code included, to a file."""
    sys.stderr.flush()
    stderr_copy = os.dup(2)  # 2 is the file descriptor of stderr
    try:
        with file.open("wb") as sink:
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        os.dup2(stderr_copy, 2)
        os.close(stderr_copy)
