"""The `kreisel` command."""

from __future__ import annotations

import os
import sys

# `python -m` looks for modules in the working folder first, which may hold anybody's files.
if __name__ == "__main__" and not sys.flags.safe_path and sys.path[0] != __file__.rsplit(os.sep, 3)[0]:
    del sys.path[0]

import ctypes
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import typer
from typer.core import TyperGroup

# The filter's matrices are small: threads inside BLAS cost more time than they save.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Plugins of other packages would be looked for among all that are installed.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")

from kreisel.cli import (  # noqa: E402 - after the environment is set
    allan,
    apply,
    array,
    batch,
    calibrate,
    certificate,
    compare,
    convert,
    demo,
    doctor,
    export,
    gauge,
    info,
    krl,
    record,
    repeat,
    robot,
    run_program,
    simulate,
    static,
    station,
    study,
    virtual_cell,
    watch,
)
from kreisel.cli.command_help import START, epilog, help_of  # noqa: E402
from kreisel.cli.foreign_warnings import keep_from_terminal  # noqa: E402
from kreisel.errors import KreiselError, UnknownColumnsError, reason_of  # noqa: E402

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # as in malloc.h

_ALLOCATIONS = 100_000
"""Objects created between two garbage collections: imports create many permanent objects, and collecting would take a
fifth of their time."""


class Program(TyperGroup):
    """All commands; with `--json` what is wrong with a command line is an object on standard output, too."""

    def make_context(self, *args: Any, **how: Any) -> Any:
        """Read the command line up to the command."""
        with _usage_as_json():
            return super().make_context(*args, **how)

    def invoke(self, ctx: Any) -> Any:
        """Read what follows the command, and run it."""
        with _usage_as_json():
            return super().invoke(ctx)


@contextmanager
def _usage_as_json() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        usage = getattr(error, "format_message", None)
        if usage is not None and "--json" in sys.argv:
            _print_error(usage())
        raise


app = typer.Typer(
    name="kreisel",
    cls=Program,
    help="Calibrate inertial measurement units while a robot or motion capture measures their motion.",
    no_args_is_help=True,
    epilog=epilog(START),
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _add(name: str, command: Callable[..., None]) -> None:
    """Add a command, with its line in the list and its examples."""
    said = help_of(name)
    app.command(name, short_help=said.summary, epilog=said.epilog)(command)


_add("calibrate", calibrate.calibrate)
_add("info", info.info)
_add("apply", apply.apply)
_add("export", export.export)
_add("certificate", certificate.certificate)
_add("verify", certificate.verify)
_add("key", certificate.key)
_add("batch", batch.batch)
_add("history", batch.history)
_add("gauge", gauge.gauge)
_add("static", static.static)
_add("robot", robot.robot)
_add("allan", allan.allan)
_add("array", array.array)
_add("repeat", repeat.repeat)
_add("compare", compare.compare)
_add("convert", convert.convert)
_add("simulate", simulate.simulate)
app.add_typer(study.app, name="study")
_add("record", record.record)
_add("run", run_program.run_program)
_add("krl", krl.krl)
_add("recover", record.recover)
_add("station", station.station)
_add("watch", watch.watch)
_add("virtual-cell", virtual_cell.virtual_cell)
_add("demo", demo.demo)
_add("doctor", doctor.doctor)


@app.callback(invoke_without_command=True)
def version(
    show: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    """Calibrate inertial measurement units while a robot or motion capture measures their motion."""
    if show:
        from kreisel import __version__

        typer.echo(__version__)
        raise typer.Exit


def run() -> None:
    """Run the command line; print our errors as one line on standard error and exit with status 1."""
    os.environ["PYTHONSAFEPATH"] = "1"  # nor do processes that are started from here look there
    keep_from_terminal()
    prepare_process()
    try:
        app()
    except UnknownColumnsError as error:
        if "--json" not in sys.argv:
            typer.echo(error.proposal)
        fail(str(error), proposal=error.proposal)
    except KreiselError as error:
        fail(str(error))
    except BrokenPipeError:
        sys.exit(1)
    except MemoryError:
        fail("out of memory; use a shorter recording or a larger --update-interval")
    except OSError as error:
        fail(f"{error.filename or 'file system'}: {error.strerror or error}")
    except Exception as error:
        if os.environ.get("KREISEL_DEBUG"):
            raise
        fail(f"{reason_of(error)}; set KREISEL_DEBUG=1 to see where, and please report it")
    finally:
        gc.freeze()  # no garbage collection is needed any more: the process ends


def prepare_process() -> None:
    """Let this process collect garbage rarely, and keep freed memory.

    New pages, zeroed by the system, took a tenth of a command's time.
    """
    gc.set_threshold(_ALLOCATIONS, 20, 50)
    with suppress(OSError, AttributeError):  # C libraries of other systems do not have it
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_TRIM_THRESHOLD, 1 << 30)
        libc.mallopt(_M_MMAP_THRESHOLD, 1 << 25)
        libc.mallopt(_M_ARENA_MAX, 1)  # what one thread has freed serves the others, too


def fail(message: str, **more: str) -> None:
    """Print one line on standard error, with `--json` an object on standard output too, and end with status 1."""
    line = " ".join(message.split())
    typer.echo(f"kreisel: {line}", err=True)
    if "--json" in sys.argv:
        _print_error(line, **more)
    sys.exit(1)


def _print_error(message: str, **more: str) -> None:
    """Print the object that stands for an error."""
    import json

    with suppress(OSError):
        typer.echo(json.dumps({"error": " ".join(message.split()), **more}))


if __name__ == "__main__":
    run()
