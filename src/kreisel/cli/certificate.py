"""`kreisel certificate`, `kreisel verify` and `kreisel key`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def certificate(
    calibration: Path = typer.Argument(..., help="Result folder, or its calibration.yaml."),
    output: Path = typer.Option(..., "-o", "--output", help="File to write, .pdf or .html."),
    language: str = typer.Option("en", "--language", help="en or de."),
    limits: str | None = typer.Option(None, help="Limits for conformity: a TOML file with [limits], or a grade."),
    field: list[str] = typer.Option(
        [], help="Field of [device] or [certificate], 'serial_number=123'; may be repeated."
    ),
    key: Path | None = typer.Option(None, help="Secret key of minisign: the signature is written beside the file."),
    force: bool = typer.Option(False, "--force", help="Replace the file."),
) -> None:
    """Write the certificate of a calibration: one page, values with expanded uncertainties (k = 2)."""
    from datetime import UTC, datetime

    from kreisel.calibration.limits import limits_named
    from kreisel.calibration.result import Calibration
    from kreisel.certificate.content import certificate_of, fields_of
    from kreisel.certificate.page import html, pdf
    from kreisel.certificate.signature import sign
    from kreisel.errors import RecordingError, SettingsError

    if output.suffix.lower() not in (".pdf", ".html"):
        raise SettingsError(f"-o {output}: expected a name that ends in .pdf or .html")
    if output.exists() and not force:
        raise RecordingError("exists already; delete it, give another name, or --force", file=output)
    secret = None if key is None else _opened(key)  # first: nothing is written for a wrong password
    found = Calibration.load(calibration)
    fields = fields_of(found, _pairs(field))
    known = None if limits is None else limits_named(limits)
    today = datetime.now(tz=UTC).astimezone().date()
    page = html(certificate_of(found, fields, known, language, today))
    content = page.encode() if output.suffix.lower() == ".html" else pdf(page)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_bytes(content)
    typer.echo(f"written: {output}")
    if secret is not None:
        digest = "" if found.recording is None else found.recording.digest or ""
        comment = f"{output.name} {today.isoformat()} data sha256 {digest}".strip()
        typer.echo(f"written: {sign(output, secret, comment)}")


def verify(
    file: Path = typer.Argument(..., help="A signed file; its signature is beside it, FILE.minisig."),
    public_key: Path = typer.Option(..., "--public-key", help="Public key of minisign of who signed."),
) -> None:
    """Verify the signature of a certificate, or of any file signed with minisign."""
    from kreisel.certificate.signature import verify as verified

    comment = verified(file, public_key)
    typer.echo(f"{file}: the signature is right. Signed comment: {comment}")


def key(
    output: Path = typer.Option(..., "-o", "--output", help="Name of the keys: NAME.key, secret, and NAME.pub."),
    password: bool = typer.Option(True, help="Encrypt the secret key with a password, which is asked for."),
) -> None:
    """Make a pair of keys for signatures, in the format of minisign."""
    from kreisel.certificate.signature import new_keys

    secret = _password("Password for the secret key", confirmed=True) if password else None
    paths = new_keys(output, secret)
    typer.echo(f"written: {paths[0]} (keep it secret), {paths[1]} (give it to those who verify)")


def _pairs(texts: list[str]) -> dict[str, str]:
    from kreisel.errors import SettingsError

    out = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingsError(f"--field {text}: expected KEY=VALUE")
        out[name.strip()] = value.strip()
    return out


def _opened(key: Path) -> Any:
    from kreisel.certificate.signature import is_encrypted, opened

    return opened(key, _password(f"Password of {key}") if is_encrypted(key) else None)


def _password(prompt: str, *, confirmed: bool = False) -> str:
    import os

    from kreisel.errors import SettingsError

    stated = os.environ.get("KREISEL_KEY_PASSWORD")
    if stated == "":
        raise SettingsError("KREISEL_KEY_PASSWORD is empty; unset it, or for a key without a password: --no-password")
    return stated if stated is not None else str(typer.prompt(prompt, hide_input=True, confirmation_prompt=confirmed))
