"""Signatures of FMUs and other archives: who made one, and whether it was changed since.

A signature stands beside the archive, in `<archive>.sig`: a document that lists the SHA-256 of the archive and of each
of its members, and an Ed25519 signature of that document. Keys are PEM files, as OpenSSL writes and reads them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

#: Name -> module; loaded when first used.
_MODULES = {
    "Signature": "cosim.signing.signatures",
    "SignatureError": "cosim.signing.document",
    "check_signed": "cosim.signing.signatures",
    "new_key": "cosim.signing.keys",
    "sign": "cosim.signing.signatures",
    "verify": "cosim.signing.signatures",
}

__all__ = ["Signature", "SignatureError", "check_signed", "new_key", "sign", "verify"]

if TYPE_CHECKING:
    from cosim.signing.document import SignatureError
    from cosim.signing.keys import new_key
    from cosim.signing.signatures import Signature, check_signed, sign, verify
else:

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            raise AttributeError(f"module 'cosim.signing' has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)
