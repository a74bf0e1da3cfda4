"""Project file of a live planner: variants and steps, saved after each change by one writer.

{"coview_live": 1, "site": NAME, "site_sha256": ..., "current": NAME, "variants": {NAME: VARIANT},
"past": [[NAME, VARIANT], ...], "question": {...}, "picture": {...}}, each variant as
`Variant.as_dict` gives it, the question as `LivePlanner.question`, the picture as the fields of
`GroundPicture`, or null. A second file keeps the state before the last save."""

import json
import math
import os
import time
from dataclasses import asdict, fields, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from placement_env.fidelity.coverage import sent_per_frame
from placement_env.handover.exchange import EXCHANGE_FILES, SCHEDULE, SITE, write_exchange
from placement_env.handover.ground import visible_ground
from placement_env.handover.mounted import format_sensors, mounted_site, unused_mounts
from placement_env.live.picture import GroundPicture
from placement_env.live.planner import LivePlanner
from placement_env.live.variant import Variant, check_name
from placement_env.report.planning.plan_folder import PLAN_FILE
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.reading import name_errors
from toolkit.runtime.text_values import read_json
from toolkit.runtime.writing import take, write_text, writing_together
from toolkit.sites.files import format_site

PROJECT_VERSION = 1
MAX_SAVED_STEPS = 100  # steps that can be undone after a reload
MAX_VARIANTS = 200
SAVE_PAUSE_S = 1.0  # s between two saves while a sensor is dragged
LAST_GOOD_ENDING = ".last-good"  # ending of the state before the last save


class ProjectFile:
    """File that keeps a planner's work, and from which the planner goes on.

    The planner takes over what the file holds, if it exists, and each later change is saved. A lock
    file keeps other processes from it until `close`. path: file, made with its folder if it is
    missing; last_good: go on from the state before the last save. Raises ValueError for a damaged
    file, the file of another site, and a file that another process writes; OSError if it cannot be
    written."""

    def __init__(self, path: Path, planner: LivePlanner, *, last_good: bool = False) -> None:
        """Lock the file, load it if it is there, and save every change from now on.

        last_good: True to load the state before the last save. Raises ValueError if another process
        has the file open."""
        self.path = path
        self.planner = planner
        self._site_sha256 = sha256(format_site(planner.yard.site).encode()).hexdigest()
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = take(path.with_name(f".{path.name}.lock"))  # None if another process has it
        if lock is None:
            raise ValueError(
                f"{path} is open in another coview live: close that, or give another --project"
            )
        self._lock_descriptor: int | None = lock  # file descriptor of the lock, None once closed
        self._saved_text = ""  # text that was written last
        self._saved_at_s = 0.0  # time (s) of the last save, by the monotonic clock
        try:
            source = self.last_good_path if last_good else path
            if last_good or path.exists():
                self._load(source)
        except BaseException:
            self.close()
            raise
        planner.listen(self.save)  # after every change
        self.save()

    @property
    def last_good_path(self) -> Path:
        """File with the state before the last save."""
        return self.path.with_name(f"{self.path.name}{LAST_GOOD_ENDING}")

    def save(self, dragging: bool = False) -> None:
        """Write the planner's state, unless it is written already or the file is closed.

        The state of the save before is kept in a second file. dragging: True for a change during a
        drag, which is skipped within `SAVE_PAUSE_S` of the last save."""
        if self._lock_descriptor is None or (
            dragging and time.monotonic() - self._saved_at_s < SAVE_PAUSE_S
        ):
            return
        text = self._format()
        if text == self._saved_text:
            return
        if self._saved_text and self.path.exists():
            # keep the present file as the last good one by a hard link that is renamed: neither
            # file is missing at any time
            link = self.path.with_name(f".{self.path.name}.spare")
            link.unlink(missing_ok=True)
            os.link(self.path, link)
            link.replace(self.last_good_path)
        write_text(self.path, text)
        self._saved_text = text
        self._saved_at_s = time.monotonic()

    def close(self) -> None:
        """Release the lock, so that others may write the file; nothing is saved any more."""
        if self._lock_descriptor is not None:
            os.close(self._lock_descriptor)
            self._lock_descriptor = None

    def _format(self) -> str:
        """JSON text of the project file, joined from texts of variants, which are cached."""
        planner = self.planner
        picture = None if planner.picture is None else asdict(planner.picture)
        head = {
            "coview_live": PROJECT_VERSION,
            "site": planner.yard.site.name,
            "site_sha256": self._site_sha256,
        }
        head |= {"current": planner.current, "question": planner.question, "picture": picture}
        variants = ", ".join(
            f"{json.dumps(name)}: {_format_variant(variant)}"
            for name, variant in planner.variants.items()
        )
        # the latest steps that can be undone: name of a variant, and the variant before the step
        past = ", ".join(
            f"[{json.dumps(name)}, {_format_variant(variant)}]"
            for name, variant in planner.past_steps[-MAX_SAVED_STEPS:]
        )
        return (
            # [:-1] drops the closing brace of the head; {{ and }} are single braces in the text
            f'{json.dumps(head, allow_nan=False)[:-1]}, "variants": {{{variants}}}, "past": '
            f"[{past}]}}"
        )

    def _load(self, path: Path) -> None:
        """Let the planner go on from a file. Raises ValueError with the file and a remedy."""
        try:
            content = read_json(path)
            with name_errors(path):
                self._take_over(content)
        except FileNotFoundError:
            raise ValueError(f"there is no {path}: start without --last-good") from None
        except ValueError as error:
            remedy = "give another --project"
            if path == self.path and self.last_good_path.is_file():
                remedy = "coview live with --last-good goes on from the state before"
            raise ValueError(f"{error}; {remedy}") from None

    def _take_over(self, content: object) -> None:
        """Give the planner the variants, past steps, picture and setting of a file's JSON content.

        Raises ValueError for a project of another version or site, and for wrong values."""
        project = JsonObject(content)
        if project.value.get("coview_live") != PROJECT_VERSION:
            raise ValueError(f"a project needs coview_live: {PROJECT_VERSION}")
        if project.value.get("site_sha256") != self._site_sha256:
            raise ValueError(
                f"it is of another site, or another version of {project.value.get('site')!r:.60}"
            )
        variants = project.node("variants")
        # steps that can be undone, the latest last
        past = project.get("past", list)
        if not 0 < len(variants.value) <= MAX_VARIANTS:
            raise ValueError(f"it needs 1 to {MAX_VARIANTS} variants, and past steps")
        variants_by_name = {
            check_name(name): Variant.from_dict(document, name)
            for name, document in variants.value.items()
        }
        steps = [self._read_step(step, number) for number, step in enumerate(past)]
        self.planner.restore(
            variants_by_name, project.get("current", str), steps[-MAX_SAVED_STEPS:]
        )
        has_picture = project.value.get("picture") is not None
        self.planner.lay(self._read_picture(project.node("picture")) if has_picture else None)
        question = project.node("question") if "question" in project.value else JsonObject({})
        if question.value:
            self._ask(question)

    @staticmethod
    def _read_step(step: object, number: int) -> tuple[str, Variant]:
        """Name and earlier state of a variant, from JSON values [name, variant] of a past step.

        number: index of the step in the file, for errors."""
        if not isinstance(step, list) or len(step) != 2 or not isinstance(step[0], str):
            raise ValueError("a past step needs a name and a variant")
        return check_name(step[0]), Variant.from_dict(step[1], f"past[{number}]")

    @staticmethod
    def _read_picture(picture: JsonObject) -> GroundPicture:
        """Picture from its JSON values, the fields of `GroundPicture`."""
        picture.check_keys([field.name for field in fields(GroundPicture)])
        try:
            return GroundPicture(**picture.value)
        except TypeError as error:
            raise ValueError(f"a picture needs all its members, got {error}") from None

    def _ask(self, question: JsonObject) -> None:
        """Change the planner's setting by the stored changes of a project.

        question: members that `LivePlanner.question` gives; those that are missing keep the present
        values."""
        question.check_keys(("classes", "iou", "errors", "scheme", "most_price"))
        case_changes: dict[str, Any] = {}
        if "iou" in question.value:
            case_changes["iou"] = tuple(question.numbers("iou"))
        if "errors" in question.value:
            case_changes["errors"] = tuple(question.texts("errors"))
        changes: dict[str, Any] = {
            "cases": replace(self.planner.asked_setting.cases, **case_changes)
        }
        if "classes" in question.value:
            changes["classes"] = question.texts("classes")
        if "scheme" in question.value:
            changes["scheme"] = question.get("scheme", str)
        if "most_price" in question.value:
            has_limit = question.value["most_price"] is not None  # JSON has no infinity
            changes["most_price"] = question.number("most_price", low=0) if has_limit else math.inf
        self.planner.ask(**changes)


@lru_cache(maxsize=2 * MAX_SAVED_STEPS)
def _format_variant(variant: Variant) -> str:
    """JSON text of a variant; most variants are in many saves, so texts are cached."""
    return json.dumps(variant.as_dict(), allow_nan=False)


def export_variant(planner: LivePlanner, folder: Path) -> list[Path]:
    """Write site.json, a map and a schedule of the variant that is shown; return their paths.

    Views that are still coarse are made in full first. Raises ValueError without a sensor and for a
    folder with a site or plan that no export wrote, OSError if it cannot be written."""
    variant = planner.variant
    site = planner.yard.site
    if not variant.sensors:
        raise ValueError("there is no sensor to export: add one")
    _check_export(folder)
    candidates = planner.yard.candidates(variant)
    members = range(len(variant.sensors))
    planner.finish()  # nothing coarse is exported
    seen, _ = planner.look(candidates)
    kbit = sent_per_frame(seen, planner.setting.fusion, planner.setting.codec)
    equipped_site = mounted_site(site, candidates, members)
    schedule = format_sensors(site, candidates, members, kbit=kbit, catalogue=planner.catalogue)
    ground = visible_ground(equipped_site, equipped_site.sensors)
    free_mounts = unused_mounts(candidates, members)
    with writing_together(folder) as unfinished:
        write_exchange(
            unfinished,
            site=equipped_site,
            sensors=schedule,
            ground=ground,
            unused=free_mounts,
            currency=planner.currency,
        )
    return [folder / name for name in EXCHANGE_FILES]


def _check_export(folder: Path) -> None:
    """Raise ValueError if an export would replace the files of a plan, or somebody's site."""
    if (folder / PLAN_FILE).exists():
        raise ValueError(
            f"{folder} is the folder of a plan, which an export would change: start with another "
            "--out"
        )
    if (folder / SITE).exists() and not (folder / SCHEDULE).exists():
        problem = f"{folder} holds a {SITE} that no export wrote"
        raise ValueError(f"{problem}: rename it, or start with another --out")


def report_variant(planner: LivePlanner, folder: Path) -> list[Path]:
    """Judge the sensors of the variant that is shown on fresh traffic, and write the full report;
    return its paths.

    All poles of the variant's sensors must carry one. The traffic is the plan's if the planner was
    opened on one, else it has the usual number of frames. It takes minutes. Raises ValueError
    without a sensor, OSError if the folder cannot be written."""
    from placement_env.report.planning.plan_writing import write_plan
    from placement_env.report.planning.planning import plan
    from placement_env.report.planning.question import Question

    candidates = planner.yard.candidates(planner.variant)
    poles = tuple(dict.fromkeys(sensor.mount for sensor in planner.sensors))  # each once
    setting = replace(
        planner.asked_setting,
        site=mounted_site(planner.yard.site, candidates, range(len(candidates))),
        candidates=replace(planner.priced_stock, candidates=candidates),
        keep=poles,
    )
    frames = None if planner.plan is None else planner.plan.given_frames
    run = replace(planner.preparation.run, frames=frames)
    return write_plan(plan(Question(setting, run, sensors=len(candidates))), folder)
