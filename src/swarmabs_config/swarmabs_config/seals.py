"""The keys with which robots and plane of a sealed swarm sign their states (`swarmabs_core.realtime.seals`), in files.

A private key is one of ECDSA on P-256 in PEM, such as that of an enclave of sros2. The public keys of all authors are
lines ``NUMBER POINT``: the id of a robot, or 0 for the plane, and a compressed point in hexadecimal digits. This module
needs the package cryptography, which nodes without keys do not.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature, encode_dss_signature
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from swarmabs_core.errors import InputError
from swarmabs_core.realtime.relayed import SIGNATURE
from swarmabs_core.realtime.seals import author_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_core.realtime.seals import SealFiles

_HALF = SIGNATURE // 2
_ALGORITHM = ec.ECDSA(SHA256())
_CURVE = ec.SECP256R1()
_REMEDY = "install the bundle of this host again"


class EcdsaSeals:
    """Signatures by ECDSA on P-256 with SHA-256, as the two numbers of 32 bytes each, big-endian."""

    def __init__(self, key: ec.EllipticCurvePrivateKey, public: Mapping[int, ec.EllipticCurvePublicKey]) -> None:
        self._key, self._public = key, dict(public)

    def sign(self, content: bytes) -> bytes:
        """Return the author's signature."""
        numbers = decode_dss_signature(self._key.sign(content, _ALGORITHM))
        return b"".join(number.to_bytes(_HALF, "big") for number in numbers)

    def holds(self, author: int, content: bytes, signature: bytes) -> bool:
        """Return whether an author has signed a content."""
        key = self._public.get(author)
        if key is None or len(signature) != SIGNATURE:
            return False
        numbers = (int.from_bytes(half, "big") for half in (signature[:_HALF], signature[_HALF:]))
        try:
            key.verify(encode_dss_signature(*numbers), content, _ALGORITHM)
        except InvalidSignature:
            return False
        return True


def public_keys(keys: Mapping[int, ec.EllipticCurvePublicKey]) -> str:
    """Return the text of a file of public keys by author."""
    points = {
        author: key.public_bytes(Encoding.X962, PublicFormat.CompressedPoint) for author, key in sorted(keys.items())
    }
    return "".join(f"{author} {point.hex()}\n" for author, point in points.items())


def opened(files: SealFiles, author: int) -> EcdsaSeals:
    """Return the keys of an author in files.

    Raises
    ------
    InputError
        If a file cannot be read or is damaged, or the private key is not that of this author.
    """
    private = Path(files.key)
    try:
        key = load_pem_private_key(_content(private), None)
    except (TypeError, ValueError) as error:
        raise InputError(f"{private} does not contain a private key", _REMEDY) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.curve.name != _CURVE.name:
        raise InputError(f"{private} contains a key that is not one of P-256", _REMEDY)
    public = _read_public(Path(files.keys))
    if author not in public or public[author] != key.public_key():
        raise InputError(f"{private} is not the key of {author_name(author)} in {files.keys}", _REMEDY)
    return EcdsaSeals(key, public)


def _read_public(path: Path) -> dict[int, ec.EllipticCurvePublicKey]:
    keys: dict[int, ec.EllipticCurvePublicKey] = {}
    for number, line in enumerate(_content(path).splitlines(), 1):
        try:
            author, point = line.decode("ascii").split()
            keys[int(author)] = ec.EllipticCurvePublicKey.from_encoded_point(_CURVE, bytes.fromhex(point))
        except ValueError as error:
            raise InputError(f"{path}, line {number}: not a number and a public key", _REMEDY) from error
    return keys


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}", _REMEDY) from error
