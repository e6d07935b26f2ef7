"""Which outputs of a component depend on which inputs and parameters, by the sparsity of its functions."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from observers.component import Component


@dataclass(frozen=True)
class Dependencies:
    """For each output, in the component's order: the positions of the inputs or parameters it depends on, ascending.

    `on_inputs`: at a communication point (direct feedthrough). `initially_on_inputs`, `initially_on_parameters`: in
    initialization mode, where the state follows from the parameters too.
    """

    on_inputs: list[list[int]]
    initially_on_inputs: list[list[int]]
    initially_on_parameters: list[list[int]]


def dependencies(component: Component) -> Dependencies:
    """The dependencies of all outputs; structural, so there may be more than there are at particular values."""
    p, u, t = ca.MX.sym("p", len(component.parameters)), ca.MX.sym("u", len(component.inputs)), ca.MX.sym("t")
    initial = ca.Function("initial", [p, u, t], [component.output(component.start(p, t), u, p, t)])
    return Dependencies(_rows(component.output, 1), _rows(initial, 1), _rows(initial, 0))


def _rows(function: ca.Function, argument: int) -> list[list[int]]:
    """For each row of the result: the rows of the argument it depends on."""
    found: list[list[int]] = [[] for _ in range(function.numel_out(0))]
    if function.numel_in(argument) > 0 and function.numel_out(0) > 0:
        rows, columns = function.jac_sparsity(0, argument).get_triplet()
        for row, column in zip(rows, columns, strict=True):
            found[row].append(column)
    return [sorted(columns) for columns in found]
