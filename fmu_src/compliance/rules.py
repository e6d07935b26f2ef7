"""The rules: what each demands, and where the standard says so. docs/compliance.md holds the same table."""

from __future__ import annotations

from dataclasses import dataclass

from fmu_src.compliance.finding import Finding, one_line


@dataclass(frozen=True)
class Rule:
    """`section`: of FMI 2.0.4, or of FMI-LS-REF 1.0.0-alpha.1 where it says so. `demand`: what holds for a sound FMU.

    `section3`: of FMI 3.0; empty for a rule that is not applied to it.
    """

    section: str
    demand: str
    section3: str = ""


STATIC = {
    "zip-sound": Rule("2.3", "every file in the archive is intact", "2.5"),
    "zip-method": Rule("2.3", "files are deflated or stored, no other method", "2.5"),
    "zip-path": Rule("2.3", "paths are relative, with forward slashes, without . and .., each there once", "2.5"),
    "zip-link": Rule("2.3", "what is in the archive is files and folders, no links", "2.5"),
    "xml-schema": Rule("2.2", "modelDescription.xml is valid against FMI's schema", "2.4"),
    "fmpy-validation": Rule("2.2", "what fmpy validates: units, start values, causalities, completeness", "2.4"),
    "variable-name": Rule("2.2.9", "names keep to the naming convention, and no name has a control character", "2.4"),
    "name-branch": Rule("2.2.9", "structured: no variable has the name of a branch (x beside x.y)", "2.4"),
    "guid": Rule("2.2.1", "the guid (FMI 3.0: the instantiationToken) is not empty", "2.4"),
    "model-identifier": Rule("4.3.1", "the modelIdentifier is a C identifier", "2.4"),
    "state-flags": Rule("4.3.1", "canSerializeFMUstate needs canGetAndSetFMUstate", "2.4"),
    "default-experiment": Rule(
        "2.2.5", "numbers are finite, stop time not before start time, step size and tolerance positive", "2.4"
    ),
    "log-category": Rule("2.2.4", "log categories have different names", "2.4"),
    "unit-name": Rule("2.2.2", "units have different names", "2.4"),
    "type-name": Rule("2.2.3", "types have different names, and none a variable's", "2.4"),
    "declared-type": Rule("2.2.7", "a declaredType is of the variable's base type", "2.4"),
    "enumeration-items": Rule("2.2.3", "the items of an enumeration have different names and values", "2.4"),
    "enumeration-start": Rule("2.2.7", "an enumeration starts at the value of one of its items", "2.4"),
    "min-max": Rule("2.2.7", "min is not above max", "2.4"),
    "start-range": Rule("2.2.7", "the start value lies in [min, max]", "2.4"),
    "alias-settable": Rule("2.2.7", "of variables with one value reference at most one can be set"),
    "alias-constant": Rule("2.2.7", "a constant shares its value reference with equal constants only"),
    "alias-unit": Rule("2.2.7", "variables with one value reference have the same unit"),
    "independent": Rule("2.2.7", "there is at most one independent variable, a Real"),
    "structure-index": Rule(
        "2.2.8", "indices (FMI 3.0: value references) in ModelStructure and derivative are those of variables", "2.4"
    ),
    "structure-duplicate": Rule("2.2.8", "an unknown is listed once in each list of ModelStructure", "2.4"),
    "dependency-known": Rule("2.2.8", "dependencies are knowns: inputs, states, time; initially also what is exact"),
    "implementation": Rule("2.3", "there is a binary, or sources", "2.5"),
    "platform-folder": Rule("2.3", "folders in binaries/ have the names that importers look for", "2.5"),
    "binary-missing": Rule("2.3", "each platform's folder holds the library named after the modelIdentifier", "2.5"),
    "binary-format": Rule("2.3", "the library is of its folder's format and machine", "2.5"),
    "exports": Rule("2.3", "all functions of the interface are exported", "2.5"),
    "undefined-symbols": Rule("2.3", "undefined symbols are those of the C library and libm", "2.5"),
    "needed-libraries": Rule(
        "2.3", "needed libraries are the system's (on Linux the C library alone), or travel in the FMU", "2.5"
    ),
    "source-files": Rule("2.3", "every listed source file is in sources/", "2.5"),
    "ls-ref-manifest": Rule("FMI-LS-REF 2.1", "the manifest is well-formed and its files are there"),
    "ls-ref-checksum": Rule("FMI-LS-REF 2.2", "related files have the checksums of the manifest"),
}

DYNAMIC = {
    "load": Rule("2.3", "the library loads"),
    "types-platform": Rule("2.1.4", "fmi2GetTypesPlatform answers default"),
    "version": Rule("2.1.4", "fmi2GetVersion answers 2.0"),
    "instantiate": Rule("2.1.5", "fmi2Instantiate returns an instance"),
    "legal-call": Rule("4.2.4", "legal calls are answered with fmi2OK or fmi2Warning"),
    "guid-mismatch": Rule("2.1.5", "fmi2Instantiate with another GUID returns a null pointer"),
    "call-order": Rule("4.2.4", "calls that the state machine forbids are answered with fmi2Error"),
    "unknown-reference": Rule("2.1.7", "a value reference that does not exist is answered with fmi2Error"),
    "set-constant": Rule("2.2.7", "a constant cannot be set"),
    "set-fixed": Rule("2.2.7", "a fixed parameter cannot be set after initialization"),
    "set-calculated": Rule("2.2.7", "what is calculated cannot be set"),
    "start-value": Rule("2.2.7", "inputs, parameters and constants start as modelDescription.xml says"),
    "set-get": Rule("2.1.7", "an input or tunable parameter that is set reads as it was set"),
    "directional-derivative": Rule(
        "2.1.9", "providesDirectionalDerivative: directional derivatives are those of finite differences"
    ),
    "continuous-states": Rule(
        "3.2.1", "model exchange: states that are set read as set, and have positive nominal values"
    ),
    "state-derivatives": Rule("3.2.2", "model exchange: derivatives and event indicators are finite along a run"),
    "event-mode": Rule("3.2.2", "model exchange: event mode can be entered, and its iteration ends"),
    "nan-input": Rule("4.2.1", "NaN or infinite inputs do not crash, hang or ruin the FMU"),
    "input-derivatives": Rule("4.2.1", "canInterpolateInputs: fmi2SetRealInputDerivatives works"),
    "output-derivatives": Rule("4.2.1", "maxOutputDerivativeOrder: fmi2GetRealOutputDerivatives works"),
    "step-size": Rule("4.2.2", "a step size that is not positive is answered with fmi2Error"),
    "communication-point": Rule("4.2.2", "a step from another time than the current one is answered with fmi2Error"),
    "stop-time": Rule("2.1.6", "a step beyond the defined stop time is answered with fmi2Error"),
    "step-variation": Rule("4.3.1", "canHandleVariableCommunicationStepSize: it does"),
    "reset": Rule("2.1.6", "after fmi2Reset an instance computes what a fresh one does"),
    "free": Rule("2.1.5", "fmi2FreeInstance works in every state, and ignores a null pointer"),
    "memory": Rule("2.1.5", "fmi2FreeInstance gives back what was taken through the callbacks"),
    "silent": Rule("2.1.5", "no message comes while logging is off and nothing fails"),
    "prints": Rule("2.1.5", "messages go to the logger, nothing to stdout or stderr"),
    "log-messages": Rule("2.1.5", "messages have the instance's name and a declared category"),
    "debug-logging": Rule("2.1.5", "every declared log category can be switched on"),
    "two-instances": Rule("4.3.1", "a second instance does not disturb the first"),
    "state-restore": Rule("2.1.8", "from a restored state the same follows"),
    "state-free": Rule("2.1.8", "fmi2FreeFMUstate sets the pointer to null and ignores null"),
    "state-serialize": Rule("2.1.8", "from a state serialised here the same follows in a new process"),
    "ls-ref-replay": Rule("FMI-LS-REF 2.5.2", "the experiments give their reference results"),
}

RULES = STATIC | DYNAMIC


def finding(rule: str, subject: str, expected: str, found: str) -> Finding:
    """A finding under one of RULES: `subject` is a variable, file or function."""
    return Finding(rule, RULES[rule].section, one_line(subject), one_line(expected), one_line(found))
