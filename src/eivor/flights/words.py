"""How a motion is spoken of: words for reports, and the sections of its flight card."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.inference.verdict import Status


@dataclass(frozen=True, slots=True)
class Words:
    """How reports speak of a motion.

    Parameters
    ----------
    title : str
        Name of the motion, as a heading.
    meanings : mapping of Status to str
        What each verdict means.
    fly : str
        What to fly when nothing else helps, one sentence.
    limits : str
        What samples are limited by, after "three seconds in the air in runs of a second or more,".
    limited_by : str
        The same as a list of nouns.
    loosen : str
        What to do when those limits leave nothing.
    no_reference : str
        What is missing when no reference is logged.
    no_lag : str
        Why there is no lag to find when the input is measured.
    where : str
        Where the vehicle is while the motion holds.
    begins : str
        What it does to get there.
    another_log : str
        What to do when it never does.
    """

    title: str
    meanings: Mapping[Status, str]
    fly: str
    limits: str = "inside the window"
    limited_by: str = "window and gaps"
    loosen: str = "Widen the window."
    no_reference: str = "None is logged."
    no_lag: str = "The input was measured:\nthere is no lag to find."
    where: str = "in the air"
    begins: str = "takes off"
    another_log: str = "Give a log of a flight."


@dataclass(frozen=True, slots=True)
class CardSection:
    """One part of a flight card.

    Parameters
    ----------
    title : str
        A few words.
    sentences : tuple of str
        What to do.
    """

    title: str
    sentences: tuple[str, ...]
