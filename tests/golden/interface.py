"""The interface as users meet it: every default and every range of functions, classes
and commands.

A default that moves changes what a script of last year computes; a range that moves
changes what is refused. The entries go by the public name, so that a function may move
between modules.

    python -m tests.golden.interface    # record it again, for a change that is wanted
"""

from __future__ import annotations

import inspect
import json
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import typer

import fraclink as fl
from fraclink._cli.app import application
from fraclink._validate import rules

Plain = dict[str, Any]
RECORD = Path(__file__).with_suffix(".json")


def interface() -> Plain:
    """Defaults and ranges of all public functions and classes, and of all commands."""
    public: Plain = {}
    for name in fl.__all__:
        thing = getattr(fl, name)
        if inspect.isfunction(thing):
            public[name] = _function(thing)
        elif inspect.isclass(thing):
            public[name] = _fields(thing)
            for method, function in vars(thing).items():
                function = getattr(function, "__func__", function)
                if inspect.isfunction(function) and not method.startswith("_"):
                    public[f"{name}.{method}"] = _function(function)
    group = typer.main.get_group(application())
    return {"functions and classes": public, "commands": _commands(group, "", None)}


def _function(function: Any) -> Plain:
    known = {name: rule.expected for name, rule in _rules(function).items()}
    return {
        p.name: _entry(
            _default(p.default, inspect.Parameter.empty), known.get(p.name, "")
        )
        for p in inspect.signature(function).parameters.values()
        if p.name != "self"
    }


def _fields(kind: type) -> Plain:
    if not is_dataclass(kind):
        return {}
    known = {name: rule.expected for name, rule in _rules(kind).items()}
    return {
        f.name: _entry(_default(f.default, MISSING), known.get(f.name, ""))
        for f in fields(kind)
        if f.init
    }


def _rules(target: Any) -> Plain:
    try:
        return rules(target)
    except (TypeError, NameError):  # annotations that state no range
        return {}


def _entry(default: str, admitted: str) -> str:
    return f"{default}; {admitted}" if admitted else default


def _default(value: object, none: object) -> str:
    """The default as text; what is no number, text or tuple of them by the name of its
    kind.
    """
    if value is none:
        return "required"
    text = repr(value)
    return type(value).__name__ if " at 0x" in text or len(text) > 120 else text


def _commands(group: Any, before: str, parent: Any) -> Plain:
    found: Plain = {}
    context = typer.Context(group, parent=parent)
    for name in sorted(group.list_commands(context)):
        command = group.get_command(context, name)
        if hasattr(command, "list_commands"):
            found |= _commands(command, f"{before}{name} ", context)
        else:
            found[before + name] = {
                " ".join(p.opts): "required"
                if p.required
                else _default(p.default, inspect.Parameter.empty)
                for p in command.params
                if p.name != "help"
            }
    return found


if __name__ == "__main__":
    RECORD.write_text(
        json.dumps(interface(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
