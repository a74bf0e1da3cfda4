"""Findings: what the doctor suspects, and why."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One suspicion about a recording, in words for the user.

    Attributes:
        severity: error or warning.
        where: dataset, sensor or frame of the file that it is about.
        suspected: the suspected mistake in words.
        evidence: the numbers that show it.
        remedy: what the user should do about it.
    """

    severity: Literal["error", "warning"]
    where: str
    suspected: str
    evidence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.suspected} ({self.evidence}); {self.remedy}"


def report_error(where: str, suspected: str, evidence: str, remedy: str) -> Finding:
    """Return a finding that is an error.

    where: dataset, sensor or frame that it is about; suspected: the mistake in words; evidence: the
    numbers that show it; remedy: what the user should do."""
    return Finding(
        severity="error", where=where, suspected=suspected, evidence=evidence, remedy=remedy
    )
