"""The Model type refuses contradictions by name and prints itself."""

import math

import casadi as ca
import pytest

from observers.instance import Instance
from observers.model import BRANCHES, Model, ModelError, Variable
from observers.pseudospectral import pseudospectral
from observers.ukf import ukf
from reference_models.duffing import DUFFING
from reference_models.plant import plant


def pendulum(**changes):
    arguments = dict(
        name="pendulum",
        states=[Variable("angle", unit="rad"), Variable("rate", unit="rad/s")],
        inputs=[Variable("torque", unit="N.m")],
        parameters=[Variable("g", unit="m/s2", start=9.81)],
        unknown_parameters=[Variable("friction", start=0.1)],
        outputs=[Variable("y", unit="rad")],
        ode=lambda x, u, p, t: [x.rate, -p.g * ca.sin(x.angle) - p.friction * x.rate + u.torque],
        output=lambda x, u, p, t: [x.angle],
    )
    return Model(**{**arguments, **changes})


def test_a_model_prints_its_dimensions_names_and_units():
    text = str(pendulum())
    assert "Model pendulum" in text
    for words in ("2 states:", "angle [rad], rate [rad/s]", "torque [N.m]", "1 unknown parameter:", "friction"):
        assert words in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (dict(ode=lambda x, u, p, t: [x.rate]), r"ode: 1 expressions for 2 variables \(angle, rate\)"),
        (dict(ode=lambda x, u, p, t: [x.rate, x.speed]), "there is no state 'speed'; known: angle, rate"),
        (dict(ode=lambda x, u, p, t: [x.rate, p.mass]), "there is no parameter 'mass'; known: g, friction"),
        (dict(output=lambda x, u, p, t: x.angle), "output: a list of expressions is wanted"),
        (dict(output=lambda x, u, p, t: [x.angle, x.rate]), "output: 2 expressions for 1 variables"),
        (dict(output=lambda x, u, p, t: [u.torque]), "output 'y' depends on no state"),
        (dict(output=lambda x, u, p, t: [ca.vertcat(x.angle, x.rate)]), "the expression for 'y' is not a scalar"),
        (dict(inputs=[Variable("angle")]), "the name 'angle' stands for a state and a input"),
        (dict(states=[Variable("a b"), Variable("rate")]), "state name 'a b' is not an identifier"),
        (dict(states=[], ode=lambda x, u, p, t: []), "has no states"),
        (dict(outputs=[], output=lambda x, u, p, t: []), "has no outputs"),
        (dict(input_between_samples="cubic"), "input_between_samples = 'cubic' must be 'held' or 'linear'"),
        (dict(algebraic=[Variable("z")]), "algebraic variables and algebraic_equations go together"),
        (dict(ode=lambda x, u, p, t: [x.rate, 1 / x.angle]), "ode: the equation for 'rate' is inf at the start values"),
        (
            dict(output=lambda x, u, p, t: [ca.log(x.angle - 1)]),
            "output: the equation for 'y' is nan at the start values",
        ),
        (
            dict(ode=lambda x, u, p: [x.rate, x.angle]),
            r"ode: .* takes 3 positional arguments but 4 were given: a function of \(x, u, p, t\) is wanted",
        ),
        (dict(ode=lambda x, u, p, t: None), r"ode: a list of expressions is wanted, \[...\], not None"),
        (
            dict(ode=lambda x, u, p, t: [x.rate, "x.angle"]),
            "the expression for 'rate' is the text 'x.angle', not a scalar",
        ),
        (
            dict(ode=lambda x, u, p, t: [x.rate, 1.0 if x.angle > 0 else 2.0]),
            "model 'pendulum', ode, line .*: Python's if",
        ),
        (dict(name="a-b"), "'a-b' is not an identifier"),
    ],
)
def test_a_contradictory_model_is_refused_with_the_reason(changes, message):
    with pytest.raises(ModelError, match=message):
        pendulum(**changes)


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        (dict(start=3.0, max=2.0), r"variable 'v': start = 3 lies outside \[-inf, 2\]"),
        (dict(nominal=0.0), "variable 'v': nominal = 0 must be greater than 0"),
        (dict(start=math.nan), "variable 'v': start = nan is not finite"),
    ],
)
def test_a_contradictory_variable_is_refused_with_the_value_and_the_limit(attributes, message):
    with pytest.raises(ModelError, match=message):
        Variable("v", **attributes)


@pytest.mark.parametrize("group", ["inputs", "outputs"])
@pytest.mark.parametrize("name", sorted(BRANCHES))
def test_an_input_or_output_called_like_a_branch_of_the_fmus_names_is_refused_by_name(group: str, name: str) -> None:
    groups = {"states": [Variable("pos")], "outputs": [Variable("y")], group: [Variable(name)]}
    with pytest.raises(ModelError, match=f"model 'bus': the {group[:-1]} '{name}' would be .* '{name}\\.\\*'"):
        Model(name="bus", **groups, ode=lambda x, u, p, t: [-x.pos], output=lambda x, u, p, t: [x.pos])


@pytest.mark.parametrize("make", [plant, lambda model: ukf(model, sample_time=0.1)])
def test_every_branch_of_a_components_names_is_refused_to_inputs_and_outputs(make) -> None:
    component = make(DUFFING)
    ports = (*component.inputs, *component.parameters, *component.outputs, *component.constants)
    assert {port.name.split(".")[0].split("[")[0] for port in ports if "." in port.name} <= BRANCHES


def test_a_method_refuses_what_it_does_not_treat_by_name():
    dae = pendulum(
        algebraic=[Variable("z")],
        algebraic_equations=lambda x, z, u, p, t: [z.z - x.angle],
        ode=lambda x, z, u, p, t: [x.rate, -p.friction * x.rate - z.z],
        output=lambda x, z, u, p, t: [x.angle],
    )
    disturbed = pendulum(unknown_disturbances=[Variable("wind")])
    with pytest.raises(ModelError, match=r"model 'pendulum' has algebraic variables \(z\)"):
        ukf(dae, sample_time=0.1)
    with pytest.raises(ModelError, match=r"has unknown disturbances \(wind\)"):
        ukf(disturbed, sample_time=0.1)


def test_unknown_disturbances_are_inputs_of_a_plant_behind_the_known_ones():
    disturbed = pendulum(
        inputs=[Variable("torque")],
        unknown_disturbances=[Variable("wind", unit="1/s2")],
        ode=lambda x, u, p, t: [x.rate, u.wind - u.torque],
    )
    true = Instance(plant(disturbed), {"start.angle": 0.0, "start.rate": 0.0})
    assert [port.name for port in true.component.inputs] == ["torque", "wind"]
    true.set("wind", 3.0)
    true.set("torque", 1.0)
    true.step(0.0, 0.5)
    assert true.get("x.rate") == pytest.approx(1.0) and true.get("y") == pytest.approx(0.25)


def test_an_unobservable_model_is_refused_naming_what_no_output_sees():
    blind = pendulum(
        output=lambda x, u, p, t: [x.rate], ode=lambda x, u, p, t: [x.rate, -p.friction * x.rate + u.torque]
    )
    with pytest.raises(ModelError, match="not observable: no output ever sees angle"):
        pseudospectral(blind, sample_time=0.1, N=15)


def test_the_observer_refuses_structure_out_of_range():
    for wrong in (
        dict(N=1),
        dict(L=0),
        dict(sample_time=0.0),
        dict(sample_time=math.nan),
        dict(cost="splines"),
        dict(cost="spline", L=2),
    ):
        with pytest.raises(ValueError, match="pseudospectral"):
            pseudospectral(DUFFING, **{"sample_time": 0.1, **wrong})


def test_a_jump_of_a_known_parameter_is_refused():
    with pytest.raises(ValueError, match="jumps of 'damping', which is no unknown parameter"):
        plant(DUFFING, jumps={"damping": 1})


def test_a_variable_without_a_unit_expression_is_refused_by_name() -> None:
    with pytest.raises(ModelError, match="variable 'force': unit = '' is no unit expression"):
        Variable("force", unit="")
