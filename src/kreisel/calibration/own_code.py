"""Estimators in files of a user's own: how they are found, and what is said of what fails in them."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from pathlib import Path

from kreisel.calibration.own_estimator import Estimator
from kreisel.errors import SettingsError


def load_estimator(text: str) -> Estimator:
    """Return the estimator that ``FILE.py:NAME`` says: a class without arguments, or an object.

    The file is executed.

    Raises
    ------
    SettingsError
        If there is no such file or name, or it does not estimate.
    """
    file, _, name = text.rpartition(":") if ":" in text else (text, "", "")
    path = Path(file)
    if not path.is_file():
        raise SettingsError(f"{text}: there is no file {file}; write FILE.py:NAME")
    if not name:
        raise SettingsError(f"{text}: say which class of {file}; write {file}:NAME")
    spec = importlib.util.spec_from_file_location(f"own_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise SettingsError(f"{text}: {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
        given = getattr(module, name, None)
        own = given() if isinstance(given, type) else given
    except Exception as error:
        raise SettingsError(f"{text}: {said(error, path)}") from error
    if own is None:
        raise SettingsError(f"{text}: {path} has no {name}")
    if not isinstance(own, Estimator):
        raise SettingsError(f"{text}: {name} needs a `name` and a method `estimate(measured)`")
    return own


def said(error: BaseException, file: Path | None = None) -> str:
    """Return what went wrong in somebody's own code: kind, message, and the last line of it."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if file is None or Path(frame.filename) == file]
    place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}: {error}{place}"
