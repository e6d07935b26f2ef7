"""Probes run in child processes: a crash or a hang of the FMU is an outcome, not the end of the check."""

from __future__ import annotations

import multiprocessing
import os
import signal
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from fmu_src.compliance.finding import Finding
from fmu_src.compliance.library.fmu import Broken, Fmu, Subject
from fmu_src.compliance.rules import finding

TIMEOUT = 30.0  # [s] for a single call: one that takes longer hangs

Probe = Callable[..., Iterator[Finding]]


@dataclass(frozen=True)
class Case:
    """One probe of one rule: `probe(fmu, *arguments)` yields findings, and may return a value for the next case."""

    rule: str
    subject: str
    probe: Probe
    arguments: tuple[Any, ...] = ()
    expected: str = "an answer"


@dataclass
class Outcome:
    """`value`: what the probe returned; None if it did not come to its end, and then there is a finding."""

    findings: list[Finding] = field(default_factory=list)
    value: Any = None
    finished: bool = False


def context() -> Any:
    """Children forked from a clean server where there is one (milliseconds each), else fresh processes."""
    methods = multiprocessing.get_all_start_methods()
    made = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        made.set_forkserver_preload(["fmu_src.compliance.check"])  # all that a child would import
    return made


def run(case: Case, subject: Subject) -> Outcome:
    """Run the case in a process of its own."""
    processes = context()
    receiver, sender = processes.Pipe(duplex=False)
    process = processes.Process(target=_child, args=(case, subject, sender), daemon=True)
    process.start()
    sender.close()
    outcome, call = Outcome(), "its start"
    try:
        while not outcome.finished:
            if not receiver.poll(TIMEOUT):
                outcome.findings.append(_ended(case, f"no answer from {call} within {TIMEOUT:g} s"))
                break
            kind, content = receiver.recv()
            match kind:
                case "call":
                    call = content
                case "finding":
                    outcome.findings.append(content)
                case "value":
                    outcome.value, outcome.finished = content, True
                case "bug":
                    raise RuntimeError(f"the probe of {case.rule} failed:\n{content}")
    except EOFError:
        process.join()
        outcome.findings.append(_ended(case, f"{_cause(process.exitcode)} in {call}"))
    finally:
        process.kill()
        process.join()
        receiver.close()
    return outcome


def _ended(case: Case, how: str) -> Finding:
    return finding(case.rule, case.subject, case.expected, how)


def _cause(code: int) -> str:
    if code < 0:
        return f"a crash ({signal.Signals(-code).name})"
    return f"the end of the process (exit code {code})"


def _child(case: Case, subject: Subject, sender: Connection) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # what the FMU prints is no business of the report
        os.dup2(silence, stream)
    try:
        fmu = Fmu(subject, lambda call: sender.send(("call", call)))
    except OSError as error:
        sender.send(("finding", finding("load", os.path.basename(subject.library), "a library that loads", str(error))))
        sender.send(("value", None))
        os._exit(0)
    try:
        probe = case.probe(fmu, *case.arguments)
        value = None
        while True:
            try:
                sender.send(("finding", next(probe)))
            except StopIteration as end:
                value = end.value
                break
        sender.send(("value", value))
    except Broken as broken:
        sender.send(("finding", broken.finding))
        sender.send(("value", None))
    except Exception:  # a fault of the probe itself, for the parent to raise
        sender.send(("bug", traceback.format_exc()))
    os._exit(0)  # at once: whatever the library does at the end of a process is not the probe's subject
