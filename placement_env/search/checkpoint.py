"""States of unfinished searches, kept in a folder, from which an interrupted search resumes.

A state is one file for each stage of a search, replaced as a whole: JSON values and arrays. The
folder's secret signs the state together with the question and the code. A damaged or forged state,
or one with another question or other code, is ignored: that stage starts from the beginning. Other
slow results (visibility, renders, detections) are in the cache.
"""

import json
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.runtime.cache import decode_arrays, encode_arrays, make_key, read_secret
from toolkit.runtime.writing import write_bytes

SAVE_INTERVAL_S = 10.0  # shortest time between two states of a stage
STATE_SUFFIX = ".state"

KeptState = dict[str, Any]  # values of JSON, and arrays


class Checkpoint:
    """State of one stage of a search.

    folder: folder of all stages, None to keep nothing; depends_on: digest of question and code, as
    a state is valid only for the same ones; part: name of the stage; every: seconds between two
    states.
    """

    def __init__(
        self,
        folder: Path | None,
        *,
        depends_on: bytes = b"",
        part: str = "search",
        every: float = SAVE_INTERVAL_S,
    ) -> None:
        """Keep where and how often one stage of a search is saved; nothing is written yet."""
        self.folder = folder  # None to keep nothing
        self._depends_on = depends_on  # digest of question and code
        self._part = part  # name of the stage
        self.every = every  # seconds between two states
        self._path = (folder or Path()) / f"{part}{STATE_SUFFIX}"  # not used without a folder
        self._saved_at = time.monotonic()  # time of the last state, or the start

    @cached_property
    def _key(self) -> bytes:
        """Key that signs states of this stage: what they depend on, and the folder's secret."""
        return make_key(self._depends_on.hex(), self._part) + read_secret(
            self._path.with_name(f"secret{STATE_SUFFIX}")
        )

    def part(self, name: str) -> "Checkpoint":
        """Checkpoint of a stage within this one, in the same folder.

        name: distinguishes the stages of this one."""
        return Checkpoint(
            self.folder, depends_on=self._depends_on, part=f"{self._part}.{name}", every=self.every
        )

    def place(self, name: str) -> Path | None:
        """Folder for other files of this stage; None if nothing is kept."""
        return None if self.folder is None else self.folder / f"{self._part}.{name}{STATE_SUFFIX}"

    def load(self) -> KeptState | None:
        """Last saved state; None if no valid state exists. Its arrays may be changed."""
        if self.folder is None or not self._path.exists():
            return None
        decoded = decode_arrays(self._key, self._path.read_bytes())
        if not decoded:  # damaged, forged, or with another question or other code
            return None
        # the first array is JSON: names of the other arrays, and all other values
        head, *arrays = decoded
        names, values = json.loads(head.tobytes())
        return values | {name: array.copy() for name, array in zip(names, arrays, strict=True)}

    def save(self, state: KeptState) -> None:
        """Save a state in place of the last one, unless nothing is kept.

        state: JSON values and arrays by name. Raises OSError if it cannot be written."""
        if self.folder is None:
            return
        arrays = {name: value for name, value in state.items() if isinstance(value, np.ndarray)}
        values = {name: value for name, value in state.items() if name not in arrays}
        head = np.frombuffer(json.dumps([list(arrays), values]).encode(), np.uint8)
        write_bytes(self._path, encode_arrays(self._key, (head, *arrays.values())))
        self._saved_at = time.monotonic()

    def offer(self, make_state: Callable[[], KeptState]) -> None:
        """Save the state that a function returns, unless one was saved in the last seconds.

        make_state: called only if the last state was saved `every` seconds ago or earlier."""
        if self.folder is not None and time.monotonic() - self._saved_at >= self.every:
            self.save(make_state())
