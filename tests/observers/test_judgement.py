"""A sample judged by its innovations where there is no covariance, against the rules of docs/canonical_dae.md and scipy's quantiles."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

from observers import judgement
from observers.model import Model, Variable
from observers.numerics.layout import Layout
from observers.status import CODE

NOISE, ALARM = np.array([0.1, 0.4]), 0.01
LIMIT = math.sqrt(chi2.isf(ALARM, 1))  # of one output, in deviations; the code's quantile is within 3 % of it here
DEVIATION = 2 * NOISE  # of an innovation


def model(wrap: float = 0.0, disturbed: bool = False) -> Model:
    return Model(
        name="pair",
        states=[Variable("a"), Variable("b")],
        outputs=[Variable("y1", wrap=wrap), Variable("y2")],
        unknown_disturbances=[Variable("d")] if disturbed else [],
        ode=lambda x, u, p, t: [x.b + (u.d if disturbed else 0), -x.a],
        output=lambda x, u, p, t: [x.a, x.b],
    )


class Said(NamedTuple):
    y: np.ndarray
    valid: np.ndarray
    innovation: np.ndarray
    rejected: float
    outlier: float
    readable: float
    contradiction: float


class Judge:
    """Judges samples one after another; the prediction is 0 and the guess predicts 5 unless told otherwise."""

    def __init__(self, of: Model, status: int = CODE.estimating):
        self.status, layout = status, Layout(**judgement.memory(of))
        memory, code = ca.SX.sym("memory", layout.total), ca.SX.sym("status")
        sample = [ca.SX.sym(name, 2) for name in ("measured", "offered", "expected", "of_guess")]
        s = SimpleNamespace(**vars(layout.unpack(memory)), status=code)
        made = judgement.judged(of, s, *sample, ca.DM(NOISE), ALARM)
        out = [*(getattr(made, name) for name in Said._fields), layout.pack(made.memory)]
        self.function = ca.Function("judge", [memory, code, *sample], [ca.densify(ca.SX(one)) for one in out])
        self.memory, self.layout = np.zeros(layout.total), layout

    def __call__(self, measured, offered=(1, 1), expected=(0, 0), of_guess=(5, 5)) -> Said:
        *found, memory = self.function(self.memory, self.status, measured, offered, expected, of_guess)
        self.memory = memory.full().ravel()
        values = [one.full().ravel() for one in found]
        return Said(*values[:3], *(float(one[0]) for one in values[3:]))

    def kept(self, part: str) -> float:
        return float(ca.DM(getattr(self.layout.unpack(self.memory), part))[0])


@pytest.mark.parametrize("output", [0, 1])
def test_an_innovation_beyond_scipys_quantile_of_twice_the_noise_is_an_outlier_and_does_not_act(output: int) -> None:
    for size, far in ((0.96 * LIMIT, 0), (1.04 * LIMIT, 1)):
        y, offered = np.zeros(2), np.eye(2)[output]  # the other one is missing: one degree of freedom
        y[output] = size * DEVIATION[output]
        said = Judge(model())(y, offered)
        assert said.outlier == far
        np.testing.assert_array_equal(said.valid, offered * (1 - far))
        np.testing.assert_allclose(said.innovation, y, rtol=1e-15)
        np.testing.assert_array_equal(said.y, y * (1 - far))
        assert said.contradiction == 0 == said.rejected


def test_two_outputs_together_have_two_degrees_of_freedom() -> None:
    limit = math.sqrt(chi2.isf(ALARM, 2) / 2)  # each
    assert [Judge(model())(part * limit * DEVIATION).outlier for part in (0.97, 1.03)] == [0, 1]


def test_three_outliers_in_a_row_do_not_act_and_the_fourth_does() -> None:
    """Missing samples in between count neither way; one that fits ends the row."""
    judge, far, none = Judge(model()), 10 * DEVIATION, (0, 0)
    assert not any(judge(far, there).valid.any() for there in ((1, 1), none, (1, 1)))
    assert judge(0.1 * DEVIATION).valid.all()
    rows = [judge(far) for _ in range(4)]
    assert [said.outlier for said in rows] == [1, 1, 1, 0]
    assert [said.contradiction for said in rows] == [0, 0, 0, 1]
    np.testing.assert_array_equal(rows[-1].y, far)
    # It has contradicted: no sample is an outlier any more, until the estimate is trusted again.
    judge.status = CODE.inconsistent
    assert judge(0.1 * DEVIATION).valid.all()
    assert judge(far).outlier == 0
    judge.status = CODE.estimating
    assert judge(far).outlier == 1


def test_an_estimate_that_was_never_trusted_has_no_outliers_and_one_with_unknown_disturbances_neither() -> None:
    for judge in (Judge(model(), CODE.settling), Judge(model(disturbed=True))):
        said = judge(10 * DEVIATION)
        assert (said.outlier, said.contradiction) == (0, 1) and said.valid.all()


@pytest.mark.parametrize(("size", "learnt"), [(0.5, 0.5), (0.01, 0.1), (0.95, 0.95)])
def test_quieter_samples_are_judged_by_their_own_size_down_to_a_tenth(size: float, learnt: float) -> None:
    """After 400 samples of innovations of `size` deviations of either sign."""
    for part, far in ((0.95, 0), (1.05, 1)):
        judge = Judge(model())
        for k in range(400):
            assert judge((-1) ** k * size * DEVIATION).outlier == 0
        assert judge(part * LIMIT * learnt * DEVIATION, (1, 0)).outlier == far


@pytest.mark.parametrize("judge", [Judge(model(), CODE.inconsistent), Judge(model(disturbed=True))])
def test_nothing_is_learnt_from_an_estimate_that_is_not_trusted_or_disturbed(judge: Judge) -> None:
    for _ in range(400):
        judge(0.01 * DEVIATION)
    assert judge.kept("level") == 0


def test_a_guess_that_predicts_ten_times_better_is_counted_while_it_does() -> None:
    judge, none = Judge(model(), CODE.inconsistent), (0, 0)

    def counted(off: float, guess_off: float, offered=(1, 1)) -> float:
        """The count after a sample of 0, in deviations off its prediction and that of the guess."""
        judge((0, 0), offered, expected=off * DEVIATION, of_guess=guess_off * DEVIATION)
        return judge.kept("outpredicted")

    assert [counted(20, 1.9), counted(-20, -1.9), counted(20, 1.9, none), counted(11, 1)] == [1, 2, 2, 3]
    assert counted(20, 2.1) == 0  # not ten times
    assert counted(20, 1.9) == 1 and counted(9.9, 0) == 0  # near enough
    assert counted(math.nan, 1.9) == 1 and counted(math.nan, math.nan) == 0
    # Of outputs that are there: the farthest of each.
    assert counted(20, 1.9) == 1 and counted(20, 1.9, (0, 1)) == 2
    judge((0, 0), expected=(0, 20 * DEVIATION[1]), of_guess=(3 * DEVIATION[0], 0))
    assert judge.kept("outpredicted") == 0


def test_a_prediction_outside_the_domain_of_the_output_is_not_readable_and_leaves_zero() -> None:
    for expected, readable in (((1, 2), 1), ((math.nan, 2), 0), ((1, math.inf), 0), ((math.nan, math.nan), 0)):
        assert Judge(model())((math.nan, 3.0), expected=expected).readable == readable
    said = Judge(model())((math.nan, 3.0), expected=(math.nan, 3.0))
    assert (said.rejected, list(said.valid), list(said.innovation), list(said.y)) == (1, [0, 1], [0, 0], [0, 3])


def test_an_angle_is_within_half_a_turn_of_its_prediction() -> None:
    said = Judge(model(wrap=360.0), CODE.settling)((725.0, 1.0), expected=(10.0, 0.0))
    np.testing.assert_allclose([said.y[0], said.innovation[0]], [5.0, -5.0], rtol=1e-14)
    assert said.y[1] == 1.0
