"""The keystore of sros2: an authority, a certificate per enclave, and signed governance and permissions.

The layout and the algorithms are those of the tool ``ros2 security``, so that its files and these can be mixed. The
authority's private key stays in the folder of keys.
"""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, pkcs7
from cryptography.x509 import Certificate, load_pem_x509_certificate
from cryptography.x509.oid import NameOID

from swarmabs_core.errors import InputError
from swarmabs_fleet.permissions import governance, host_enclaves, permissions
from swarmabs_fleet.places import enclave

if TYPE_CHECKING:
    from swarmabs_config.fleet.model import Fleet
    from swarmabs_fleet.keys import Keys

CA_KEY, CA_CERTIFICATE = "sros2/ca.key.pem", "sros2/ca.cert.pem"
_RESTORE = "restore it, or remove it and deploy anew"


def keystore(fleet: Fleet, host: str, keys: Keys, valid_days: int) -> dict[str, bytes]:
    """Return the files of a host's keystore by path.

    Parameters
    ----------
    fleet : Fleet
        The fleet.
    host : str
        The host, which gets the private keys of its own enclaves and no others.
    keys : Keys
        Where keys, certificates and signatures are kept.
    valid_days : int
        Validity of certificates that are made now, days.

    Raises
    ------
    InputError
        If what is kept is damaged.
    """
    authority = _Authority(fleet, keys, valid_days)
    files: dict[str, bytes] = {}
    ca = authority.certificate_pem
    rules = governance(fleet.network.domain)
    for name, rights in host_enclaves(fleet, host).items():
        path = enclave(fleet, name)
        key, certificate = authority.entity(name, path)
        first, last = authority.validity(certificate)
        granted = permissions(fleet.network.domain, path, rights, first, last)
        folder = f"enclaves{path}"
        files |= {
            f"{folder}/identity_ca.cert.pem": ca,
            f"{folder}/permissions_ca.cert.pem": ca,
            f"{folder}/cert.pem": certificate,
            f"{folder}/key.pem": key,
            f"{folder}/governance.p7s": authority.signed("governance", rules),
            f"{folder}/permissions.xml": granted.encode(),
            f"{folder}/permissions.p7s": authority.signed(f"{name}/permissions", granted),
        }
    return files


class _Authority:
    """Signs; what it has signed once it returns again, since no two signatures of one text are alike."""

    def __init__(self, fleet: Fleet, keys: Keys, valid_days: int) -> None:
        self._keys = keys
        self._days = valid_days
        key = keys.kept(CA_KEY, _new_key)
        self._key = _load_key(keys, CA_KEY, key)
        name = f"swarmabs {fleet.name} CA"
        self.certificate_pem = keys.kept(CA_CERTIFICATE, lambda: self._issue(name, self._key, None))
        self._certificate = _load_certificate(keys, CA_CERTIFICATE, self.certificate_pem)

    def entity(self, name: str, path: str) -> tuple[bytes, bytes]:
        """Return private key and certificate of an enclave."""
        key = self._keys.kept(f"sros2/{name}/key.pem", _new_key)
        secret = _load_key(self._keys, f"sros2/{name}/key.pem", key)
        certificate = self._keys.kept(f"sros2/{name}/cert.pem", lambda: self._issue(path, secret, self._certificate))
        found = _load_certificate(self._keys, f"sros2/{name}/cert.pem", certificate)
        if found.public_key() != secret.public_key() or not self._has_issued(found):
            folder = self._keys.folder / "sros2"
            raise InputError(
                f"{folder / name / 'cert.pem'} does not fit its key or the authority; restore the folder {folder}, "
                "or remove it and deploy anew to all hosts"
            )
        return key, certificate

    def _has_issued(self, certificate: Certificate) -> bool:
        try:
            certificate.verify_directly_issued_by(self._certificate)
        except (InvalidSignature, TypeError, ValueError):
            return False
        return True

    def validity(self, certificate: bytes) -> tuple[str, str]:
        """Return from when to when a certificate is valid, as permissions name it."""
        found = _load_certificate(self._keys, "certificate", certificate)
        first, last = _validity(found)
        return f"{first:%Y-%m-%dT%H:%M:%S}", f"{last:%Y-%m-%dT%H:%M:%S}"

    def signed(self, name: str, text: str) -> bytes:
        """Return a text as a signed S/MIME message."""
        content = text.encode()
        signature = self._keys.read(f"sros2/{name}.p7s")
        if signature is None or self._keys.read(f"sros2/{name}.xml") != content:
            signature = self._sign(content)
            # The text comes last: without it the signature counts as none.
            self._keys.write(f"sros2/{name}.xml", b"")
            self._keys.write(f"sros2/{name}.p7s", signature)
            self._keys.write(f"sros2/{name}.xml", content)
        return signature

    def _sign(self, content: bytes) -> bytes:
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        builder = pkcs7.PKCS7SignatureBuilder().set_data(content)
        return builder.add_signer(self._certificate, self._key, hashes.SHA256()).sign(
            serialization.Encoding.SMIME, options
        )

    def _issue(self, name: str, key: EllipticCurvePrivateKey, issuer: Certificate | None) -> bytes:
        """Return a new certificate in PEM: of an enclave, or of the authority itself if there is no issuer."""
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        # From yesterday on: a robot whose clock is a little slow must not refuse it.
        today = datetime.now(timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0)
        last = today + timedelta(days=self._days)
        if issuer is not None:
            last = min(last, _validity(issuer)[1])
        path_length = None if issuer is not None else 1
        builder = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject if issuer is None else issuer.subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(today - timedelta(days=1))
            .not_valid_after(last)
            .add_extension(x509.BasicConstraints(ca=issuer is None, path_length=path_length), critical=True)
        )
        return builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def _validity(certificate: Certificate) -> tuple[datetime, datetime]:
    """Return from when to when a certificate is valid; the cryptography of Ubuntu 24.04 names these times otherwise."""
    if hasattr(certificate, "not_valid_after_utc"):
        return certificate.not_valid_before_utc, certificate.not_valid_after_utc
    first, last = certificate.not_valid_before, certificate.not_valid_after
    return first.replace(tzinfo=timezone.utc), last.replace(tzinfo=timezone.utc)


def _new_key() -> bytes:
    return ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _load_key(keys: Keys, name: str, content: bytes) -> EllipticCurvePrivateKey:
    try:
        key = load_pem_private_key(content, None)
    except (TypeError, ValueError) as error:
        raise InputError(f"{keys.folder / name} holds no private key; {_RESTORE}") from error
    if not isinstance(key, EllipticCurvePrivateKey):
        raise InputError(f"{keys.folder / name} holds a key of another kind; {_RESTORE}")
    return key


def _load_certificate(keys: Keys, name: str, content: bytes) -> Certificate:
    try:
        return load_pem_x509_certificate(content)
    except ValueError as error:
        raise InputError(f"{keys.folder / name} holds no certificate; {_RESTORE}") from error
