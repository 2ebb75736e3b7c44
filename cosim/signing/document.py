"""What is signed of an archive: its own hash, and those of its members, to say which one was changed."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path
from typing import IO, Any

from cosim.errors import CosimError

#: Ending of a signature's name, behind that of the archive.
SIGNATURE_ENDING = ".sig"

#: First member of each document, so that no other signed text can be taken for one.
FORMAT = "cosim archive signature 1"

#: A signature file that is larger is none: a member takes about a hundred bytes.
MOST_BYTES = 64 << 20

#: An archive that unpacks to more than this is not looked into.
_MOST_UNPACKED = 4 << 30

#: Bytes that are hashed at once.
_CHUNK = 1 << 20

#: Members that are named in a message.
_MOST_NAMED = 5


class SignatureError(CosimError):
    """An archive is not signed, not by the right key, or was changed since; or a key can't be read."""


def document_of(path: Path) -> str:
    """The document about an archive, as JSON.

    Raises
    ------
    SignatureError
        It is not a zip archive, or has several members of one name.
    OSError
        It can't be read.
    """
    with path.open("rb") as stream:
        about = {"format": FORMAT, "sha256": _sha256(stream), "members": members_of(path, stream)}
    return json.dumps(about, sort_keys=True, separators=(",", ":"))


def members_of(path: Path, stream: IO[bytes]) -> dict[str, str]:
    """Name -> SHA-256 of the members of an archive.

    Raises
    ------
    SignatureError
        It is not a zip archive, or has several members of one name.
    """
    found: dict[str, str] = {}
    try:
        with zipfile.ZipFile(stream) as archive:
            if sum(member.file_size for member in archive.infolist()) > _MOST_UNPACKED:
                raise SignatureError(f"{path}: unpacks to more than {_MOST_UNPACKED >> 30} GB, as no FMU does")
            for member in archive.infolist():
                if member.filename in found:
                    raise SignatureError(f"{path}: has several members '{member.filename}'; export it again")
                with archive.open(member) as content:
                    found[member.filename] = _sha256(content)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError) as error:
        raise SignatureError(f"{path}: can't be read as a zip archive: {' '.join(str(error).split())}") from error
    return found


def read_document(text: str, where: Path) -> dict[str, Any]:
    """The contents of a document.

    Raises
    ------
    SignatureError
        It is none.
    """
    try:
        about = json.loads(text)
    except (ValueError, RecursionError):
        about = None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise SignatureError(f"{where}: is not a signature of this kind; sign the archive again: cosim sign")
    members = about.get("members")
    if not isinstance(about.get("sha256"), str) or not isinstance(members, dict):
        raise SignatureError(f"{where}: its document lacks hashes; sign the archive again: cosim sign")
    return about


def differences(path: Path, about: dict[str, Any]) -> str:
    """How an archive differs from the document about it, in words; empty where it does not."""
    with path.open("rb") as stream:
        if _sha256(stream) == about["sha256"]:
            return ""
        try:
            here = members_of(path, stream)
        except SignatureError as error:
            return str(error).removeprefix(f"{path}: ")
    then = about["members"]
    parts = []
    for what, names in (
        ("changed", [n for n in here if n in then and here[n] != then[n]]),
        ("added", [n for n in here if n not in then]),
        ("removed", [n for n in then if n not in here]),
    ):
        if names:
            more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
            parts.append(f"{what}: {', '.join(sorted(names)[:_MOST_NAMED])}{more}")
    return "; ".join(parts) or "members are the same, but packed otherwise"


def _sha256(stream: IO[bytes]) -> str:
    stream.seek(0)
    digest = hashlib.sha256()
    while chunk := stream.read(_CHUNK):
        digest.update(chunk)
    return digest.hexdigest()
