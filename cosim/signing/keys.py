"""Ed25519 keys in PEM files: the private one signs and stays offline, the public one goes to whoever verifies."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.errors import needs
from cosim.files.whole import write_whole
from cosim.signing.document import SignatureError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey


def public_path(path: Path) -> Path:
    """Where the public key of a private one in a file is."""
    return path.with_name(f"{path.name}.pub")


def new_key(path: str | PathLike[str], passphrase: str = "") -> str:
    """Write a new private key into a file that only its owner can read, and the public one beside it (`.pub`).

    Parameters
    ----------
    path : path
        New.
    passphrase : str
        Encrypts the private key, if there is one.

    Returns
    -------
    str
        Fingerprint of the public key.

    Raises
    ------
    SignatureError
        There is a file of that name already.
    OSError
        A file can't be written.
    """
    with needs("sign"):
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    path = Path(path)
    for existing in (path, public_path(path)):
        if existing.exists():
            raise SignatureError(f"{existing} already exists, and a lost key can't be recovered; choose another name")
    key = Ed25519PrivateKey.generate()
    encryption = (
        serialization.BestAvailableEncryption(passphrase.encode()) if passphrase else serialization.NoEncryption()
    )
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)
    public = key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
        stream.write(pem)
        stream.flush()
        os.fsync(stream.fileno())
    write_whole(public_path(path), lambda part: part.write_bytes(public))
    return fingerprint(key.public_key())


def private_key(path: Path, passphrase: Callable[[], str]) -> Ed25519PrivateKey:
    """The private key in a file; `passphrase` is asked where it is encrypted.

    Raises
    ------
    SignatureError
        It has none, or the passphrase is another one.
    """
    with needs("sign"):
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    pem = _read(path)
    try:
        try:
            key = serialization.load_pem_private_key(pem, None)
        except TypeError:  # it is encrypted
            key = serialization.load_pem_private_key(pem, passphrase().encode())
    except (ValueError, TypeError) as error:
        if b"PUBLIC KEY" in pem:
            raise SignatureError(f"{path}: is a public key, which can't sign; give the private one") from None
        raise SignatureError(f"{path}: no private key can be read from it: {_line(error)}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise SignatureError(f"{path}: is not an Ed25519 key; make one with: cosim sign --new-key FILE")
    return key


def public_key(path: Path) -> Ed25519PublicKey:
    """The public key in a file.

    Raises
    ------
    SignatureError
        It has none.
    """
    with needs("sign"):
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    pem = _read(path)
    if b"PRIVATE KEY" in pem:
        raise SignatureError(f"{path}: is a private key, which only the signer should have; give {path}.pub")
    try:
        key = serialization.load_pem_public_key(pem)
    except (ValueError, TypeError) as error:
        raise SignatureError(f"{path}: no public key can be read from it: {_line(error)}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise SignatureError(f"{path}: is not an Ed25519 key; cosim sign --new-key FILE makes such keys")
    return key


def fingerprint(key: Ed25519PublicKey) -> str:
    """Short name of a key, as OpenSSH gives it: the SHA-256 of its 32 bytes in base 64."""
    digest = hashlib.sha256(key.public_bytes_raw()).digest()
    return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SignatureError(f"{path}: can't be read: {error.strerror or error}; check the path of the key") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
