"""`kreisel certificate`, `kreisel verify` and `kreisel key`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from kreisel.cli import completion


def certificate(
    calibration: Path = typer.Argument(..., help="Result folder, or its calibration.yaml."),
    output: Path = typer.Option(..., "-o", "--output", help="File to write, .pdf or .html."),
    language: str = typer.Option(
        "en", "--language", help="en or de.", autocompletion=completion.one_of(completion.LANGUAGES)
    ),
    limits: str | None = typer.Option(
        None, help="Limits for conformity: a TOML file with [limits], or a grade.", autocompletion=completion.grades
    ),
    field: list[str] = typer.Option(
        [],
        help="Field of [device] or [certificate], 'serial_number=123'; may be repeated.",
        autocompletion=completion.fields,
    ),
    key: Path | None = typer.Option(None, help="Secret key of minisign: the signature is written beside the file."),
    force: bool = typer.Option(False, "--force", help="Replace the file."),
) -> None:
    """Write the certificate of a calibration: one page, values with expanded uncertainties (k = 2).

    Exit status with --limits: 0 if all conform, 3 if something does not, 4 if of something no decision can be made; the
    certificate is written all the same. 3 also for a rejected calibration, which gets no certificate.
    """
    from datetime import UTC, datetime

    from kreisel.batch.outcomes import REJECTED
    from kreisel.calibration.limits import limits_named
    from kreisel.calibration.result import Calibration
    from kreisel.certificate.certificate_page import html, pdf
    from kreisel.certificate.content import certificate_of, fields_of
    from kreisel.certificate.signature import sign
    from kreisel.certificate.statement import as_comment, digest_of, statement_of
    from kreisel.cli.conformity import sentence, status_of
    from kreisel.cli.foreign_warnings import kept_from_standard_error
    from kreisel.errors import RecordingError, SettingsError
    from kreisel.files import write_whole

    if output.suffix.lower() not in (".pdf", ".html"):
        raise SettingsError(f"-o {output}: expected a name that ends in .pdf or .html")
    if output.exists() and not force:
        raise RecordingError("exists already; delete it, give another name, or --force", file=output)
    secret = None if key is None else _opened(key)  # first: nothing is written for a wrong password
    found = Calibration.load(calibration)
    if not found.accepted:
        typer.echo(f"kreisel: {calibration}: was rejected, and gets no certificate; see its report", err=True)
        raise typer.Exit(REJECTED)
    fields = fields_of(found, _pairs(field))
    known = None if limits is None else limits_named(limits)
    today = datetime.now(tz=UTC).astimezone().date()
    digest = digest_of(calibration)
    made = certificate_of(found, fields, known, language, today, digest)
    page = html(made)
    with kept_from_standard_error():
        content = page.encode() if output.suffix.lower() == ".html" else pdf(page)
    write_whole(output, content)
    typer.echo(f"written: {output}")
    if secret is not None:
        stated = statement_of(output.name, today.isoformat(), made.serial_number, found, digest)
        typer.echo(f"written: {sign(output, secret, as_comment(stated))}")
    if made.decision is not None:
        typer.echo(sentence(made.judged, made.decision))
    if status := status_of(found, made.decision):
        raise typer.Exit(status)


def verify(
    file: Path = typer.Argument(..., help="A signed file; its signature is beside it, FILE.minisig."),
    public_key: Path = typer.Option(..., "--public-key", help="Public key of minisign of who signed."),
    calibration: Path | None = typer.Option(
        None, help="Result folder, or calibration.yaml, that the certificate must belong to."
    ),
) -> None:
    """Verify the signature of a certificate, or of any file signed with minisign.

    A certificate must have the name under which it was signed. With --calibration its result file, recording and serial
    number must be those that were signed.
    """
    from kreisel.certificate.signature import verify as verified
    from kreisel.certificate.statement import check_calibration, check_name, stated_in

    comment = verified(file, public_key)
    statement = stated_in(comment)
    if statement is not None:
        check_name(file, statement)
    if calibration is not None:
        check_calibration(file, statement, calibration)
    if statement is None:
        typer.echo(f"{file}: the signature is right. Signed comment: {comment}")
        return
    typer.echo(
        f"{file}: the signature is right. Issued {statement.issued} for serial number "
        f"{statement.serial_number or '(not stated)'}, recording {statement.recording or '(not stated)'}"
    )
    typer.echo(f"data SHA-256 {statement.data_sha256 or '(not stated)'}")
    typer.echo(f"calibration.yaml SHA-256 {statement.calibration_sha256}")
    if calibration is not None:
        typer.echo(f"it is the certificate of {calibration}")


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
