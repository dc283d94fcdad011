"""Verdicts on the requirements, and the page about a run that an integrator can sign, as text and as HTML.

Verdicts depend only on the evidence: the same evidence results in the same verdicts.
"""

from __future__ import annotations

import html
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from urlink import BadValue
from urlink.tools import Progress, printable, unseen

from .agreement import AGREEMENT
from .arrivals import ARRIVALS, listening
from .causes import likely_causes
from .evidence import Evidence
from .listening import ANSWERS
from .obedience import OBEDIENCE
from .physics import PHYSICS
from .plots import plots
from .reactions import REACTIONS
from .requirements import Check, NotTried, Requirement
from .swings import SWINGS
from .wrist import WRIST_CHECKS

State = Literal["held", "not held", "not tried"]

#: Checks of the requirements. The keys are the names of the requirements.
CHECKS: Mapping[str, Check] = {
    **ARRIVALS,
    **AGREEMENT,
    **PHYSICS,
    **ANSWERS,
    **OBEDIENCE,
    **REACTIONS,
    **WRIST_CHECKS,
    **SWINGS,
}


@dataclass(frozen=True)
class Verdict:
    """Verdict on one requirement.

    Attributes:
        requirement: Requirement with its limit.
        state: Result: "held", "not held" or "not tried".
        value: Measured value, in the unit of the limit; None if the requirement was not tried.
        seen: Description of the result, or the reason why the requirement was not tried.
        contradicts: Parameters that the result contradicts, each with the measured value.
    """

    requirement: Requirement
    state: State
    value: float | None
    seen: str
    contradicts: tuple[str, ...] = ()


def judge(evidence: Evidence, requirements: Mapping[str, Requirement], progress: Progress = unseen) -> list[Verdict]:
    """Return the verdicts in the order of the requirements. `progress` is called with the completed fraction."""
    stages = {note.said["number"]: note.said for note in evidence.said("stage")}
    verdicts = []
    for number, each in enumerate(requirements.values()):
        progress(number / len(requirements))
        verdicts.append(_verdict(each, evidence, CHECKS[each.name], stages))
    return verdicts


def _verdict(
    required: Requirement, evidence: Evidence, check: Check, stages: Mapping[int, Mapping[str, str]]
) -> Verdict:
    stage = stages.get(required.stage, {"refused": "it was not requested"})
    if "refused" in stage:
        return Verdict(required, "not tried", None, f"stage {required.stage} was not run: {stage['refused']}")
    try:
        found = check(evidence)
    except NotTried as reason:
        return Verdict(required, "not tried", None, str(reason))
    except BadValue as error:
        # The evidence is invalid, for example because a position is not a number. Another requirement reports this.
        return Verdict(required, "not tried", None, f"it cannot be judged: {error}")
    if not found.value <= required.limit and (delayed := evidence.busy(*_judged(required, evidence))):
        return Verdict(required, "not tried", None, f"this computer was busy: {delayed}; {found.seen}")
    # Compare with <= and not with >, so that a value of NaN is not held.
    return Verdict(required, "held" if found.value <= required.limit else "not held", *found)


#: Steps that a requirement of stage 1 or 2 judges, if the steps have other names than the requirement.
_STEPS: Mapping[str, tuple[str, ...]] = {
    "texts": ("sleep",),
    "program-state": ("sleep",),
    "move-arrives": ("move",),
    "slider-scales": ("move",),
    "follow-scales": ("follow-100", "follow-50", "follow-10"),
}


def _judged(required: Requirement, evidence: Evidence) -> tuple[float, float]:
    """Return the time span of the step that a requirement judges; an empty span if it judges no step."""
    notes = [note.at for step in _STEPS.get(required.name, (required.name,)) for note in evidence.said(step)]
    if required.name in _ARRIVES:
        return listening(evidence)
    return (min(notes), max(notes)) if notes and required.stage in (1, 2) else (math.inf, -math.inf)


#: Requirements of stage 0 about the times of arrival.
_ARRIVES = ("realtime-jitter", "rtde-jitter", "rtde-fresh", "primary-fresh", "realtime-missed")

_WIDTH = 100
_TITLE = "Acceptance of a controller with urlink"
_SIGNED = ("Name", "Place, date", "Signature")
#: Statement on the page about its scope.
_SCOPE = (
    "This page describes what this controller and this library did together in this run. It is not a risk assessment, "
    "and does not describe the safety functions of the cell."
)


def is_accepted(verdicts: Sequence[Verdict]) -> bool:
    """Return whether at least one requirement was tried, and all tried requirements are held."""
    return any(each.state == "held" for each in verdicts) and all(each.state != "not held" for each in verdicts)


def _about(evidence: Evidence, site: Mapping[str, Any], digest: str, address: str) -> Iterator[tuple[str, str]]:
    about, known = evidence.last("about") or {}, evidence.identity
    if "address" in about:
        # In a bundle, a network address is overwritten with x.
        yield "address", address or about["address"]
    if "wall" in about:
        yield "date", time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(about["wall"]))
    if known is not None:
        yield "controller", f"{known.model or 'an arm of unknown model'}, firmware {known.firmware}"
    yield "library", f"urlink {about.get('urlink')}, Python {about.get('python')}, {about.get('system')}"
    for key, value in site.items():
        yield key, str(value)
    for note in evidence.said("stage-ended"):
        yield f"stage {note.said['number']}", f"ended early: {note.said['error']}"
    if digest:
        yield "evidence", f"sha256 {digest}"


def _is_simulated(evidence: Evidence) -> bool:
    return bool((evidence.last("about") or {}).get("simulated"))


def _failed(verdicts: Sequence[Verdict]) -> Iterator[str]:
    """Yield the lines about the requirements that are not held: the likely causes, and all names."""
    yield from (
        f"Likely cause: {cause}" if not number else f"Also: {cause}"
        for number, cause in enumerate(likely_causes(verdicts))
    )
    broken = [each.requirement.name for each in verdicts if each.state == "not held"]
    if broken:
        yield f"NOT HELD: {', '.join(broken)}"


def _result(verdicts: Sequence[Verdict]) -> str:
    states = [each.state for each in verdicts]
    said = f"{states.count('held')} held, {states.count('not held')} not held, {states.count('not tried')} not tried"
    return f"{'ACCEPTED' if is_accepted(verdicts) else 'NOT ACCEPTED'}: {said}"


def _measured(each: Verdict) -> str:
    if each.value is None:
        return ""
    unit = f" {each.requirement.unit}" if each.requirement.unit else ""
    return f"{each.value:.4g}{unit} of at most {each.requirement.limit:g}{unit}"


def as_text(
    evidence: Evidence, verdicts: Sequence[Verdict], site: Mapping[str, Any], digest: str = "", address: str = ""
) -> str:
    """Return the page as text. The page depends only on the evidence, the limits, the site and the address."""
    lines = [_TITLE, "=" * len(_TITLE), ""]
    if _is_simulated(evidence):
        lines += [f"{' SIMULATED ARM ':*^{_WIDTH}}", ""]
    lines += [_result(verdicts), *map(printable, _failed(verdicts)), ""]
    lines += [f"{name:12} {printable(value)}" for name, value in _about(evidence, site, digest, address)]
    stage = None
    for each in verdicts:
        if each.requirement.stage != stage:
            stage = each.requirement.stage
            lines += ["", f"Stage {stage}", "-" * _WIDTH]
        state = "NOT HELD" if each.state == "not held" else each.state
        lines.append(f"{state:10} {each.requirement.name:18} {_measured(each)}".rstrip())
        lines.append(f"           {printable(each.seen)}")
        lines += [f"           CONTRADICTS the parameter {printable(said)}" for said in each.contradicts]
        if each.state == "not held":
            lines.append(f"           measured: {each.requirement.what}")
            lines.append(f"           required because {each.requirement.why} ({each.requirement.source})")
    lines += ["", "-" * _WIDTH, _SCOPE, ""]
    lines += [f"{name:14}{'_' * 50}\n" for name in _SIGNED]
    return "\n".join(lines)


_STYLE = """
body { font: 11pt/1.4 sans-serif; max-width: 60em; margin: 2em auto; color: #222; }
table { border-collapse: collapse; width: 100%; margin: 1em 0; font-size: 10pt; }
th, td { text-align: left; vertical-align: top; padding: .25em .6em; border-bottom: 1px solid #ddd; }
.held { color: #1a6b2d; } .not-held { color: #b00020; font-weight: bold; } .not-tried { color: #777; }
.sign td { height: 2.5em; border-bottom: 1px solid #222; }
figure { margin: 1em 0; } figcaption { font-size: 10pt; }
.simulated { position: fixed; inset: 0; display: flex; align-items: center; justify-content: center; font-size: 12vw;
  font-weight: bold; color: #b00020; opacity: .15; transform: rotate(-30deg); pointer-events: none; }
@media print { body { margin: 0; } tr { break-inside: avoid; } }
"""


def as_html(
    evidence: Evidence, verdicts: Sequence[Verdict], site: Mapping[str, Any], digest: str = "", address: str = ""
) -> str:
    """Return the page as HTML without external resources. The page depends only on the arguments."""

    def cell(text: object) -> str:
        return f"<td>{html.escape(printable(text))}</td>"

    about = _about(evidence, site, digest, address)
    head = "".join(f"<tr><th>{html.escape(name)}</th>{cell(value)}</tr>" for name, value in about)
    rows = "".join(_row(each, cell) for each in verdicts)
    mark = '<div class="simulated">SIMULATED</div>\n' if _is_simulated(evidence) else ""
    failed = "".join(f'<p class="not-held">{html.escape(printable(line))}</p>\n' for line in _failed(verdicts))
    sign = "".join(f"<tr><th>{name}</th><td></td></tr>" for name in _SIGNED)
    titles = "".join(f"<th>{name}</th>" for name in ("stage", "requirement", "verdict", "measured", "seen", "limit"))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{_TITLE}</title>'
        f"<style>{_STYLE}</style></head><body>\n{mark}<h1>{_TITLE}</h1>\n"
        f"<p><strong>{_result(verdicts)}</strong></p>\n{failed}<table>{head}</table>\n{plots(evidence)}<table><tr>{titles}</tr>{rows}</table>\n"
        f'<p>{_SCOPE}</p>\n<table class="sign">{sign}</table>\n</body></html>\n'
    )


def _row(each: Verdict, cell: Any) -> str:
    required: Requirement = each.requirement
    state = f'<td class="{each.state.replace(" ", "-")}">{each.state}</td>'
    limit = f"{required.what}; because {required.why} ({required.source})"
    seen = "; ".join((each.seen, *(f"CONTRADICTS the parameter {said}" for said in each.contradicts)))
    cells = f"{cell(required.stage)}{cell(required.name)}{state}{cell(_measured(each))}{cell(seen)}{cell(limit)}"
    return f"<tr>{cells}</tr>\n"
