"""Making and checking signatures."""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from cosim.errors import needs
from cosim.files.whole import write_whole
from cosim.signing.document import (
    MOST_BYTES,
    SIGNATURE_ENDING,
    SignatureError,
    differences,
    document_of,
    read_document,
)
from cosim.signing.keys import fingerprint, private_key, public_key


@dataclass(frozen=True)
class Signature:
    """A signature that was found right.

    Attributes
    ----------
    key : Path
        Whose public key it is.
    fingerprint : str
        Of that key.
    sha256 : str
        Of the archive.
    members : int
        Their number.
    """

    key: Path
    fingerprint: str
    sha256: str
    members: int


def signature_path(path: Path) -> Path:
    """Where the signature of an archive is."""
    return path.with_name(f"{path.name}{SIGNATURE_ENDING}")


def sign(path: str | PathLike[str], key: str | PathLike[str], passphrase: Callable[[], str] = lambda: "") -> Path:
    """Sign an archive; one that was signed before gets a new signature.

    Parameters
    ----------
    path : path
        FMU or SSP.
    key : path
        PEM file of the private key.
    passphrase : callable, optional
        Asked where the key is encrypted.

    Returns
    -------
    Path
        File of the signature: equal archives have equal ones, for it has no time.

    Raises
    ------
    SignatureError
        The key, or the archive, can't be read.
    OSError
        A file can't be read or written.
    """
    path = Path(path)
    signer = private_key(Path(key), passphrase)
    text = document_of(path)
    content = {
        "document": text,
        "key": fingerprint(signer.public_key()),
        "signature": base64.b64encode(signer.sign(text.encode())).decode(),
    }
    target = signature_path(path)
    write_whole(target, lambda part: part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8"))
    return target


def verify(path: str | PathLike[str], keys: Sequence[str | PathLike[str]]) -> Signature:
    """Check that an archive is as one of some signers has signed it.

    Parameters
    ----------
    path : path
    keys : sequence of path
        PEM files of public keys.

    Raises
    ------
    SignatureError
        It has no signature, that of another key, or was changed since; the message says what.
    OSError
        The archive can't be read.
    """
    with needs("sign"):
        from cryptography.exceptions import InvalidSignature

    path = Path(path)
    known = [(key, public_key(key)) for key in map(Path, keys)]
    where = signature_path(path)
    text, signature, claimed = _read(path, where)
    for key, verifier in known:
        try:
            verifier.verify(signature, text.encode())
        except InvalidSignature:
            continue
        about = read_document(text, where)
        if changed := differences(path, about):
            raise SignatureError(f"{path}: was changed after it was signed with {key} ({changed}); get it again")
        return Signature(key, fingerprint(verifier), str(about["sha256"]), len(about["members"]))
    if claimed in (fingerprint(verifier) for _, verifier in known):
        raise SignatureError(f"{where}: was changed, or is damaged; get it again, with its archive")
    names = ", ".join(str(key) for key in keys)
    raise SignatureError(f"{path}: was not signed with {names}, but with the key {claimed}; trust it or do without")


def check_signed(paths: Iterable[str | PathLike[str]], keys: Sequence[str | PathLike[str]]) -> None:
    """Check that each of some archives is as one of some signers has signed it, before anything of it runs.

    Raises
    ------
    SignatureError
        One is not.
    """
    for path in dict.fromkeys(map(Path, paths)):
        if not path.is_file():
            raise SignatureError(f"{path}: there is no such file; check the path")
        verify(path, keys)


def _read(path: Path, where: Path) -> tuple[str, bytes, str]:
    """Document, signature, and the fingerprint of the key that it claims to be by."""
    try:
        if where.stat().st_size > MOST_BYTES:
            raise SignatureError(f"{where}: is too large for a signature; get the one that its maker has written")
        content = json.loads(where.read_text(encoding="utf-8"))
        text, claimed = content["document"], content["key"]
        signature = base64.b64decode(content["signature"], validate=True)
    except FileNotFoundError:
        raise SignatureError(
            f"{path}: is not signed: there is no {where.name} beside it; sign it: cosim sign"
        ) from None
    except (ValueError, KeyError, TypeError, RecursionError, binascii.Error):
        raise SignatureError(f"{where}: is not a signature of this kind; sign the archive again: cosim sign") from None
    if not isinstance(text, str) or not isinstance(claimed, str):
        raise SignatureError(f"{where}: is not a signature of this kind; sign the archive again: cosim sign")
    return text, signature, claimed
