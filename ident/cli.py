"""ident: the command line of its commands, what can be refused at once, and how errors are told."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from io import TextIOWrapper
from pathlib import Path

from ident import record_options
from ident.commands import add as commands_of_a_machine
from ident.diagnosis_commands import add as commands_of_the_loop
from ident.errors import IdentError
from ident.identification_commands import add as commands_of_an_identification
from symgen.errors import SymgenError

#: Threads cost more than they give on the small matrices here; set before numpy is first imported.
_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ident",
        description="Identify the inertia matrix J(q) of an arm with elastic joints from frequency responses.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
        return sub

    commands_of_an_identification(command)
    commands_of_a_machine(command)
    commands_of_the_loop(command)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status.

    0 done; 1 done, but a problem was found (a fit that does not explain its data); 2 misuse or bad input (one line).
    """
    for name in _ONE_THREAD:
        os.environ.setdefault(name, "1")
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # of a name that the terminal can not show
    options = _parser().parse_args(arguments)
    try:
        _check(options)
        status: int = options.action(options)
        return status
    except (IdentError, SymgenError) as error:
        return _failed(str(error))
    except OSError as error:
        return _failed(": ".join(str(part) for part in (error.filename, error.strerror or error) if part is not None))
    except KeyboardInterrupt:
        _failed(f"interrupted{_kept(options)}")
        return 130


def _kept(options: argparse.Namespace) -> str:
    """What is left of a command that was interrupted: the records of a simulation that is not complete."""
    files = {"simulate": "", "run": "campaign.h5"}  # in `out`, as `resume` writes beside them
    if options.command in files and Path(f"{Path(options.out, files[options.command])}.partial").is_dir():
        return "; records that are done stay, the same command goes on there"
    return ""


def _failed(message: str) -> int:
    """One line on standard error, whatever a path may hold."""
    print(f"ident: {' '.join(message.splitlines())}", file=sys.stderr)
    return 2


def _check(options: argparse.Namespace) -> None:
    """Refuses at once what would otherwise be found after minutes of simulation."""
    for name, value in vars(options).items():
        if isinstance(value, str) and "\0" in value:
            raise IdentError(f"{'-o' if name == 'out' else name} {value!r}: expected text without null characters")
    if getattr(options, "seed", 0) < 0:
        raise IdentError(f"--seed {options.seed}: expected 0 or more")
    record_options.check(options)
    if "method" in options:
        from ident.identification.identify import METHODS

        if options.method not in (*METHODS, "all"):
            raise IdentError(f"method {options.method!r}: expected one of {', '.join(METHODS)}, all")
    if getattr(options, "out", None) is None:
        return
    if options.command in ("run", "fit", "export", "diagnose"):
        from ident.identification.export import check_place

        check_place(options.out)
    out = Path(options.out)
    if options.command in ("simulate", "import"):
        if out.is_dir():
            raise IdentError(f"-o {out}: a directory; expected a file to write")
        if not out.parent.is_dir():
            raise IdentError(f"-o {out}: no directory {out.parent}; expected one that exists")
    elif out.exists() and not out.is_dir():
        raise IdentError(f"-o {out}: a file; expected a directory")
    nearest = next(path for path in (out, *out.resolve().parents) if path.exists())
    if not os.access(nearest if nearest.is_dir() else nearest.parent, os.W_OK):
        raise IdentError(f"-o {out}: {nearest} can not be written to")


if __name__ == "__main__":
    sys.exit(main())
