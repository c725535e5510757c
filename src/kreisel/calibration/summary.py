"""The verdict in a headline and a sentence: the same words on the terminal, in the report and in the result file."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from kreisel.calibration.verdict import Verdict


@dataclass(frozen=True)
class Summary:
    """The verdict in a headline and a sentence, with the reasons where it is rejected."""

    accepted: bool
    headline: str
    sentence: str
    reasons: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Headline and sentence."""
        return f"{self.headline}. {self.sentence}"


def summarise(verdict: Verdict, unobservable: Collection[str]) -> Summary:
    """Return the verdict in plain words.

    Parameters
    ----------
    unobservable
        Parameters the motion does not show, or too weakly.
    """
    if not verdict.accepted:
        return Summary(False, "Rejected", "Do not use this calibration.", verdict.reasons)
    if not unobservable:
        sentence = "The result fits the data, and the motion shows every parameter that was estimated. It may be used."
        return Summary(True, "Accepted", sentence)
    lost = len(unobservable)
    which, those = ("one parameter", "it") if lost == 1 else (f"{lost} parameters", "those")
    sentence = (
        f"The result fits the data and may be used, but the motion does not show {which}, or too weakly to be of use. "
        f"Do not rely on {those}."
    )
    return Summary(True, "Accepted, with gaps", sentence)
