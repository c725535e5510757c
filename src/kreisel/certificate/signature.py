"""Signatures of files in the format of minisign: any program for it verifies them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from kreisel.errors import LibraryError, RecordingError
from kreisel.files import open_fresh, write_whole

SUFFIX = ".minisig"


def sign(path: Path, secret: Any, comment: str) -> Path:
    """Write the signature of a file beside it, and return its path.

    Parameters
    ----------
    secret
        As `opened` returns it.
    comment
        One line that is signed, too.
    """
    signature = secret.sign(path.read_bytes(), trusted_comment=" ".join(comment.split()))
    out = path.with_name(path.name + SUFFIX)
    write_whole(out, bytes(signature))
    return out


def opened(key: Path, password: str | None) -> Any:
    """Return a secret key of minisign, ready to sign; the password of one that is not encrypted is None.

    Raises
    ------
    RecordingError
        If the key cannot be read, or the password is wrong or missing.
    """
    minisign = _library()
    secret = _read(key, minisign.SecretKey.from_file, "a secret key")
    try:
        if secret.is_encrypted():
            if password is None:
                raise RecordingError(
                    "is encrypted: its password is asked for, or taken from KREISEL_KEY_PASSWORD", file=key
                )
            secret.decrypt(password)
    except (minisign.Error, ValueError) as error:
        raise RecordingError(f"cannot sign with it: {error}", file=key) from error
    return secret


def is_encrypted(key: Path) -> bool:
    """Return whether a secret key needs a password.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    minisign = _library()
    return bool(_read(key, minisign.SecretKey.from_file, "a secret key").is_encrypted())


def verify(path: Path, public_key: Path) -> str:
    """Return the signed comment of a file whose signature is beside it and right.

    Raises
    ------
    RecordingError
        If the signature is missing or wrong, or a file cannot be read.
    """
    minisign = _library()
    beside = path.with_name(path.name + SUFFIX)
    for file in (path, beside, public_key):
        if not file.is_file():
            raise RecordingError("no such file", file=file)
    public = _read(public_key, minisign.PublicKey.from_file, "a public key")
    signature = _read(beside, minisign.Signature.from_file, "a signature")
    try:
        public.verify(path.read_bytes(), signature)
    except (minisign.Error, ValueError) as error:
        raise RecordingError(
            f"the signature is wrong ({error}): the file was changed, or signed with another key than {public_key}",
            file=path,
        ) from error
    return str(signature.trusted_comment)


def new_keys(stem: Path, password: str | None) -> tuple[Path, Path]:
    """Write a new pair of keys, STEM.key and STEM.pub, and return their paths.

    Raises
    ------
    RecordingError
        If one exists already.
    """
    minisign = _library()
    paths = stem.with_name(stem.name + ".key"), stem.with_name(stem.name + ".pub")
    for path in paths:
        if path.exists() or path.is_symlink():
            raise RecordingError("exists already; give another name", file=path)
    pair = minisign.KeyPair.generate()
    if password:
        pair.secret_key.encrypt(password)
    for path, key, mode in zip(paths, (pair.secret_key, pair.public_key), (0o600, 0o644), strict=True):
        with open_fresh(path, mode) as file:
            file.write(bytes(key))
    return paths


def _read(path: Path, read: Callable[[Path], Any], what: str) -> Any:
    try:
        return read(path)
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}", file=path) from error
    except (_library().Error, ValueError, IndexError) as error:
        raise RecordingError(f"not {what} of minisign: {error}", file=path) from error


def _library() -> Any:
    try:
        import minisign
    except ImportError as error:
        raise LibraryError("signatures need py-minisign: pip install 'kreisel[certificate]'") from error
    return minisign
