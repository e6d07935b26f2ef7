"""The pages that travel inside an FMU: documentation/index.html, the licences and the icon."""

from __future__ import annotations

import math
from html import escape
from importlib.resources import files

from fmu_src.description.model_description import LICENSE, LOG_CATEGORIES, TOOL, Entry, entries
from fmu_src.documentation.figures import icon, panels, plot
from fmu_src.errors import ExperimentFailed
from fmu_src.platforms import PLATFORMS
from observers.component import Component, Port, bounds

LICENSES = ("observer-fmus.txt", "fmi-headers.txt", "casadi.txt")

_CSS = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1, h2 { color: #204a70; line-height: 1.2; } h2 { margin-top: 2.2rem; }
table { border-collapse: collapse; font-size: 13px; width: 100%; }
th, td { text-align: left; padding: .25rem .6rem; border-bottom: 1px solid #ddd; }
th { background: #f3f6f9; } td.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
code, pre { font: 13px ui-monospace, monospace; background: #f3f6f9; }
pre { padding: .8rem; overflow-x: auto; } svg { max-width: 100%; height: auto; }
"""

# By target.
_NATURE = {
    "native": "native code without any run-time dependency",
    "python": "a PythonFMU: it runs inside a tool that holds a Python with the packages casadi and numpy",
}
_BINARIES = {
    "native": f"""<h2>Binaries and sources</h2>
<p>Binaries are under <code>binaries/</code>, for one or more of {", ".join(PLATFORMS)}.
For any other platform <code>sources/</code> holds everything: it is C99 with the C library and libm only. Compile with
<code>cc -std=c99 -O2 -ffp-contract=off -fPIC -shared *.c -lm</code>. To link several FMUs into one program, compile each with
<code>-DFMI2_FUNCTION_PREFIX=</code>, the model's identifier and an underscore: every name then begins with them.
<code>sources/embedded/</code> shows how to run it on a micro-controller, without FMI. Never compile with
<code>-ffast-math</code>: NaN and infinity must be told from numbers.""",
    "python": """<h2>Binaries and resources</h2>
<p><code>resources/</code> holds the component as serialised CasADi functions and <code>component.json</code>, and the modules
that run it. Under <code>binaries/</code> PythonFMU's library stands beside a small one that relays the calls to it.""",
}

_FAILURES = (
    ("wrong GUID, missing instance name, model exchange", "fmi2Instantiate returns a null pointer and logs why"),
    ("illegal call order, unknown value reference, wrong type", "fmi2Error and one message"),
    (
        "parameter out of range or NaN, fixed parameter set after initialization",
        "fmi2Error and one message with the variable, value and limit",
    ),
    (
        "step from another time than the current one, beyond the stop time, not positive",
        "fmi2Error and one message with both numbers",
    ),
    ("the state would not be finite after the step", "fmi2Error and one message"),
    (
        "a counter of troubles rises in a step",
        "fmi2OK and a message in the category logStatusWarning with the counter, its value and the time",
    ),
)


def pages(
    component: Component, guid: str, driven_by: Component | None, target: str, has_references: bool
) -> dict[str, bytes]:
    """Contents by path in the FMU, made for `target`, "native" or "python"."""
    licenses = files("fmu_src.documentation") / "licenses"
    return {
        "model.png": icon(component.name),
        "documentation/index.html": _page(component, guid, driven_by, target, has_references).encode(),
        **{f"documentation/licenses/{name}": (licenses / name).read_bytes() for name in LICENSES},
    }


def _experiment(component: Component, driven_by: Component | None) -> str:
    """The plot of the default experiment, or why there is none."""
    head = "<h2>What it does</h2>\n"
    try:
        times, rows = panels(component, driven_by)
    except ExperimentFailed as error:
        return f"{head}<p>No plot: {escape(str(error))}. Other start values or inputs may do better.</p>"
    if not rows:
        return ""
    if driven_by is None:
        caption = "Default experiment: the component alone, with its start values."
    else:
        caption = f"Default experiment: driven by the plant {escape(driven_by.name)}, both with their start values."
    return f"{head}<figure>{plot(times, rows)}<figcaption>{caption}</figcaption></figure>"


def _page(component: Component, guid: str, driven_by: Component | None, target: str, has_references: bool) -> str:
    name = escape(component.name)
    references = (
        '<p>Reference results travel with it: <a href="fmi-ls-ref.txt">fmi-ls-ref.txt</a>.</p>'
        if has_references
        else ""
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{name}</title><style>{_CSS}</style></head>
<body>
<h1>{name}</h1>
<p>{escape(component.description)}</p>
<p>A co-simulation FMU (FMI 2.0), {_NATURE[target]}.
Generated by {TOOL}; GUID {escape(guid)}; licence {LICENSE}.</p>
{component.documentation}
{_experiment(component, driven_by)}
{references}
<h2>Variables</h2>
{_variables(component)}
<h2>Time</h2>
{_time(component)}
<h2>How to use it</h2>
{_usage(component)}
<h2>When something goes wrong</h2>
{_failures(component)}
{_BINARIES[target]} Licences are under
<a href="licenses/">documentation/licenses</a>.</p>
</body>
</html>
"""


def _variables(component: Component) -> str:
    rows = "\n".join(_row(entry) for entry in entries(component))
    head = "<th>name</th><th>what</th><th>variability</th><th>unit</th><th>start</th><th>range</th><th>description</th>"
    return f"<table>\n<tr>{head}</tr>\n{rows}\n</table>"


def _row(entry: Entry) -> str:
    port = entry.port
    start = "" if entry.initial == "calculated" else _literal(port, port.start)
    low, high = bounds(port)
    limits = "" if math.isinf(low) and math.isinf(high) else f"[{_literal(port, low)}, {_literal(port, high)}]"
    description = escape(port.description)
    if port.enumeration is not None:
        items = "; ".join(f"{value}: {item}" for value, (item, _) in enumerate(port.enumeration.items, start=1))
        description += f" ({escape(items)})"
    kind = "constant" if entry.group == "constant" else port.variability
    unit = port.unit if port.kind == "Real" else port.kind
    return (
        f"<tr><td><code>{escape(port.name)}</code></td><td>{entry.causality}</td><td>{kind}</td><td>{escape(unit)}</td>"
        f"<td class=n>{start}</td><td class=n>{limits}</td><td>{description}</td></tr>"
    )


def _literal(port: Port, value: float) -> str:
    """A value as the variable's type has it; a whole number with all its digits."""
    if port.kind == "Boolean":
        return "true" if value else "false"
    return f"{value:g}" if port.kind == "Real" else f"{value:.0f}"


def _time(component: Component) -> str:
    text = (
        "<p>In <code>fmi2DoStep(t, h)</code> every sample instant in [t, t + h) is treated with the inputs set before "
        "the step, then the state moves to t + h: outputs read at t + h are those of time t + h. The step size may "
        "vary. Times are counted in whole nanoseconds from the start time, so importers that accumulate, multiply or "
        "round times get identical results. First derivatives of inputs (<code>fmi2SetRealInputDerivatives</code>) "
        "hold for one step.</p>"
    )
    if component.sample_time:
        what = (
            f"the parameter <code>{component.sample_time}</code>"
            if isinstance(component.sample_time, str)
            else f"{component.sample_time:g} s"
        )
        text += f"<p>Sample instants are t0 + k Ts, where Ts is {what}.</p>"
    if component.samples_inputs:
        text += "<p>The inputs are sampled, so a step longer than Ts is refused; it may be any shorter.</p>"
    return text


def _usage(component: Component) -> str:
    name = escape(component.name)
    return f"""<p>In any tool that imports FMI 2.0 for co-simulation. In Python:</p>
<pre>import fmpy
result = fmpy.simulate_fmu(
    "{name}.fmu", stop_time={component.stop_time:g}, output_interval={component.step_size:g}
)</pre>
<p>In a system (SSP 1.0), as one of its components; connect inputs and outputs by their names:</p>
<pre>&lt;ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" source="resources/{name}.fmu"/&gt;</pre>
<p>The order that every co-simulation master shares suits it: get all outputs, set all inputs, step all.</p>"""


def _failures(component: Component) -> str:
    failures = list(_FAILURES)
    if component.samples_inputs:
        failures.insert(4, ("a step longer than the sample time", "fmi2Error and one message with both numbers"))
    rows = "\n".join(f"<tr><td>{event}</td><td>{answer}</td></tr>" for event, answer in failures)
    categories = ", ".join(f"<code>{name}</code> ({text})" for name, text in LOG_CATEGORIES.items())
    counters = (
        f" Counters of this FMU: {', '.join(f'<code>{escape(c)}</code>' for c in component.counters)}."
        if component.counters
        else ""
    )
    return (
        f"<table>\n<tr><th>event</th><th>answer</th></tr>\n{rows}\n</table>\n"
        "<p>After fmi2Error the instance is as it was before the call, and may go on. "
        f"Messages come when logging is on, in the categories {categories}.{counters}</p>"
    )
