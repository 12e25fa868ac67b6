"""Faults planted in the samples: each is found by its own rule, and little else is."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest
from support.planted_layers import LAYERS, PlantedLayer, planted
from support.planted_takes import TAKES, Planted
from support.suite import some_quick

from animtool.core.errors import Fault, Severity
from animtool.core.rules import builtin_rules
from animtool.motion.take import Take
from animtool.scene.bake.bake import bake
from animtool.scene.sources.open import open_source
from animtool.validation.motion.subject import MotionSubject
from animtool.validation.run import findings_in
from animtool.validation.subjects.open import open_file

RULES = [rule for rule in builtin_rules().values() if rule.takes]

ROOT = Path(__file__).parents[3]
SAMPLES = {
    "walk": "samples/walk/walk.bvh",
    "wave1": "samples/batch/takes/left/wave1.bvh",
    "stride": "samples/stride/stride.clip.yaml",
    "carry": "samples/carry/carry.clip.yaml",
    "press": "samples/press/press.clip.yaml",
    "speech": "samples/speech/speech.clip.yaml",
}
HEADING = "planted faults: expected | found | others that follow | others"


Case = Planted | PlantedLayer


class Outcomes:
    """What is found in each case, worked out when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.known: dict[str, list[Fault]] = {}

    @cache  # noqa: B019
    def take(self, name: str) -> Take:
        return open_source(ROOT / SAMPLES[name]).collect()

    @cache  # noqa: B019
    def layer(self, name: str) -> Path:
        path = self.folder / f"{name}.usdc"
        bake(ROOT / SAMPLES[name], path)
        return path

    def of(self, case: Case) -> list[Fault]:
        key = f"{type(case).__name__} {case.sample} {case.name}"
        if key not in self.known:
            self.known[key] = self._found(case)
        return self.known[key]

    def _found(self, case: Case) -> list[Fault]:
        if isinstance(case, Planted):
            return findings(case.edit(self.take(case.sample)))
        path = self.folder / f"planted{len(self.known)}.usdc"
        return findings_in(open_file(planted(case, self.layer(case.sample), path)))

    def others(self, case: Case) -> list[Fault]:
        """Return what is found besides the fault and what follows from it."""
        expected = {case.code, *case.extra}
        return [fault for fault in self.of(case) if fault.code not in expected]


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> Outcomes:
    return Outcomes(tmp_path_factory.mktemp("planted"))


def findings(take: Take) -> list[Fault]:
    """Return what every motion rule finds in a take, whatever file it is from."""

    def fault_at(
        code: str, joint: str, frame: float | None, message: str, hint: str
    ) -> Fault:
        del frame
        assert message
        return Fault(code, message, hint=hint, where=joint)

    subject = MotionSubject(take, fault_at)
    return [fault for rule in RULES for fault in rule.load()(subject)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    some_quick([*TAKES, *LAYERS], 4),
    ids=lambda case: f"{case.sample}-{case.name}",
)
def test_a_planted_fault_is_found(
    case: Case, outcomes: Outcomes, record_property: Any
) -> None:
    codes = {fault.code for fault in outcomes.of(case)}
    others = outcomes.others(case)
    record_property(
        HEADING,
        f"  {case.sample + ': ' + case.name:<52} {case.code} | "
        f"{'yes' if case.code in codes else 'NO'} | "
        f"{' '.join(sorted(codes & case.extra)) or '-'} | "
        f"{' '.join(fault.code for fault in others) or '-'}",
    )
    assert case.code in codes
    assert [str(fault) for fault in others] == []


def test_there_are_forty_and_every_rule_has_one() -> None:
    assert len(TAKES) + len(LAYERS) >= 40
    codes = {case.code for case in (*TAKES, *LAYERS)}
    assert {rule.code for rule in RULES} <= codes


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_the_clean_samples_have_no_finding(name: str, outcomes: Outcomes) -> None:
    found = findings(outcomes.take(name))
    found += findings_in(open_file(outcomes.layer(name)))
    assert [str(f) for f in found if f.severity is not Severity.NOTE] == []


@pytest.mark.slow(1)
def test_precision_and_recall(outcomes: Outcomes, record_property: Any) -> None:
    cases = [*TAKES, *LAYERS]
    hits = sum(any(f.code == c.code for f in outcomes.of(c)) for c in cases)
    said = sum(len(outcomes.of(case)) for case in cases)
    wrong = sum(len(outcomes.others(case)) for case in cases)
    record_property(
        HEADING,
        f" recall {hits / len(cases):.3f}: {hits} of {len(cases)} planted; "
        f"precision {1 - wrong / said:.3f}: {said - wrong} of {said} findings",
    )
    assert hits == len(cases)
