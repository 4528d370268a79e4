"""The keys of a fleet: those of WireGuard, or the certificate authority, certificates and signatures of sros2.

Each is generated once, stored in a folder that only its owner can read, and reused by every later deployment. Layout
and algorithms of the keystore are those of ``ros2 security``, so files of both tools can be mixed. The private key of
the authority never leaves the key folder.
"""

from __future__ import annotations

import base64
import os
import shutil
import stat
from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key, pkcs7
from cryptography.x509 import Certificate, CertificateRevocationList, load_pem_x509_certificate
from cryptography.x509.oid import NameOID

from swarmabs_config.files import write_whole
from swarmabs_config.fleet.participants import node_plans
from swarmabs_config.fleet.parts import Sros2Security
from swarmabs_config.model.fields import nearest
from swarmabs_config.seals import public_keys
from swarmabs_core.errors import InputError, RunError
from swarmabs_fleet.host_plan import PUBLIC_KEYS, HostPlan
from swarmabs_fleet.permissions import host_rights

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from swarmabs_config.fleet.model import Fleet

_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_CA_KEY, _CA_CERTIFICATE = "sros2/ca.key.pem", "sros2/ca.cert.pem"
_REVOKED = "sros2/crl.pem"
_OF_AUTHORITY = x509.KeyUsage(
    digital_signature=True,
    content_commitment=False,
    key_encipherment=False,
    data_encipherment=False,
    key_agreement=False,
    key_cert_sign=True,
    crl_sign=True,
    encipher_only=False,
    decipher_only=False,
)
"""What the authority's key signs: permissions, certificates and the certificate revocation list."""
_RESTORE = "restore it from a backup, or remove it and deploy again"


class Keys:
    """A folder of secrets and signed files by name; each is generated at its first use and kept from then on.

    Raises
    ------
    InputError
        If other accounts can enter the folder, or it cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            mode = folder.stat().st_mode
        except OSError as error:
            raise InputError(f"the key folder {folder} cannot be used: {error.strerror}; choose another") from error
        if mode & _OTHERS:
            raise InputError(f"other accounts can enter the key folder {folder}; run: chmod 700 {folder}")

    def kept(self, name: str, make: Callable[[], bytes]) -> bytes:
        """Return the content stored under a name; generate and store it first if it does not exist.

        Raises
        ------
        InputError
            If it cannot be read, or other accounts can read it.
        RunError
            If it cannot be written.
        """
        content = self.read(name)
        if content is None:
            content = make()
            self.write(name, content)
        return content

    def write(self, name: str, content: bytes) -> None:
        """Store content under a name atomically; raise `RunError` if it cannot be written."""
        path = self.folder / name
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_whole(path, content, mode=0o600, sync=True)
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}; free space, then deploy again") from error

    def remove(self, name: str) -> None:
        """Remove a folder and its contents; raise `RunError` if that fails."""
        try:
            shutil.rmtree(self.folder / name)
        except OSError as error:
            raise RunError(f"{error.filename} cannot be removed: {error.strerror}; remove it by hand") from error

    def read(self, name: str) -> bytes | None:
        """Return the content stored under a name, None if there is none.

        Raises
        ------
        InputError
            If it cannot be read, or other accounts can read it.
        """
        path = self.folder / name
        try:
            with path.open("rb") as file:
                if os.fstat(file.fileno()).st_mode & _OTHERS:
                    raise InputError(f"other accounts can read {path}, so it may be known; remove it and deploy again")
                return file.read()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}; check the path and its permissions") from error

    def revoke(self, fleet: Fleet, names: Sequence[str]) -> None:
        """Revoke sros2 certificates; the next deployment generates new keys for the enclaves that still exist.

        Parameters
        ----------
        fleet : Fleet
            The fleet, which uses sros2 security.
        names : sequence of str
            Hosts of the fleet, each for all enclaves of its bundle, and single enclaves.

        Raises
        ------
        InputError
            If a name is neither, or a stored file is damaged; nothing is revoked.
        RunError
            If the revocation list cannot be written, or a revoked key cannot be removed.
        """
        kept = [path.parent.name for path in sorted(self.folder.glob("sros2/*/cert.pem"))]
        hosts = {host.name: [*host_rights(HostPlan(fleet, host.name))] for host in fleet.hosts}
        enclaves: list[str] = []
        for name in names:
            if not (certified := [enclave for enclave in hosts.get(name, [name]) if enclave in kept]):
                remedy = nearest(name, [*hosts, *(enclave for enclave in kept if enclave not in hosts)])
                raise InputError(f"{self.folder} has no certificate of '{name}'; {remedy}")
            enclaves += certified
        _Authority.of(self, fleet).revoke([*dict.fromkeys(enclaves)])

    def files(self, host: HostPlan) -> dict[str, bytes]:
        """Return the files with keys of a host's bundle by path; they contain no private keys of other hosts.

        Raises
        ------
        InputError
            If a stored file is damaged.
        """
        security = host.fleet.security
        if host.fleet.tunnel is not None:
            return {f"wireguard/{host.fleet.tunnel.interface}.conf": _wireguard(self, host).encode()}
        return _keystore(self, host) if isinstance(security, Sros2Security) else {}


def _wireguard(keys: Keys, host: HostPlan) -> str:
    """Return the wg-quick configuration of a host: robots connect to the coordinators, coordinators to all hosts.

    Without an observer all hosts connect to each other.
    """
    central = {node.host for node in node_plans(host.fleet) if node.robot is None}
    others = [other.name for other in host.fleet.hosts if other.name != host.name]
    met = [other for other in others if host.fleet.decentralised or host.name in central or other in central]
    peers = {other: _in_base64(_wireguard_key(keys, other).public_key().public_bytes_raw()) for other in met}
    own = _in_base64(_wireguard_key(keys, host.name).private_bytes_raw())
    return host.render("wireguard.conf", private=own, peers=peers)


def _wireguard_key(keys: Keys, host: str) -> X25519PrivateKey:
    """Return the private key of a host, generated at the first call."""
    name = f"wireguard/{host}.key"
    kept = keys.kept(name, lambda: base64.b64encode(X25519PrivateKey.generate().private_bytes_raw()) + b"\n")
    try:
        return X25519PrivateKey.from_private_bytes(base64.b64decode(kept.strip(), validate=True))
    except ValueError as error:
        raise InputError(f"{keys.folder / name} does not contain a private key; {_RESTORE}") from error


def _in_base64(key: bytes) -> str:
    return base64.b64encode(key).decode()


def _keystore(keys: Keys, host: HostPlan) -> dict[str, bytes]:
    """Return the files of a host's keystore by path."""
    authority = _Authority.of(keys, host.fleet)
    revoked = authority.revoked()
    rules = authority.signed("governance", host.render("governance.xml"))
    files: dict[str, bytes] = {}
    for name, rights in host_rights(host).items():
        path = host.enclave(name)
        key, pem, certificate = authority.entity(name, path)
        first, last = (f"{time:%Y-%m-%dT%H:%M:%S}" for time in _validity(certificate))
        granted = host.render("permissions.xml", enclave=path, rights=rights, not_before=first, not_after=last)
        enclave = {
            "identity_ca.cert.pem": authority.pem,
            "permissions_ca.cert.pem": authority.pem,
            "cert.pem": pem,
            "key.pem": key,
            "governance.p7s": rules,
            "permissions.xml": granted.encode(),
            "permissions.p7s": authority.signed(f"{name}/permissions", granted),
        }
        if revoked is not None:
            enclave["crl.pem"] = revoked.public_bytes(serialization.Encoding.PEM)
        files |= {f"keystore/enclaves{path}/{file}": content for file, content in enclave.items()}
    if host.fleet.sealed:
        files[PUBLIC_KEYS] = _public_keys(authority, host).encode()
    return files


def _public_keys(authority: _Authority, host: HostPlan) -> str:
    """Return the public keys of all who sign states, which are those of their certificates."""
    authors = {node.author: node.name for node in node_plans(host.fleet) if node.author is not None}
    return public_keys({author: authority.secret(name).public_key() for author, name in authors.items()})


class _Authority:
    """The certificate authority; it reuses stored signatures, since no two signatures of a text are the same."""

    def __init__(self, keys: Keys, name: str, valid_days: int) -> None:
        self._keys, self._days = keys, valid_days
        _, self._key = self._kept_key(_CA_KEY)
        self.pem, self._certificate = self._kept_certificate(
            _CA_CERTIFICATE, lambda: self._issue(name, self._key, None)
        )

    @classmethod
    def of(cls, keys: Keys, fleet: Fleet) -> _Authority:
        """Return the authority of a fleet; its certificates are valid for `valid_days` of the fleet's security."""
        days = fleet.security.valid_days if isinstance(fleet.security, Sros2Security) else 0
        return cls(keys, f"swarmabs {fleet.name} CA", days)

    def revoked(self) -> CertificateRevocationList | None:
        """Return the certificate revocation list, None if no certificate has been revoked."""
        content = self._keys.read(_REVOKED)
        if content is None:
            return None
        path = self._keys.folder / _REVOKED
        try:
            revocations = x509.load_pem_x509_crl(content)
        except ValueError as error:
            raise InputError(f"{path} is not a certificate revocation list; restore it from a backup") from error
        if not revocations.is_signature_valid(self._certificate.public_key()):  # type: ignore[arg-type]
            raise InputError(f"{path} is not signed by the authority; restore the folder that contains both")
        return revocations

    def revoke(self, names: Sequence[str]) -> None:
        """Add the certificates of enclaves to the revocation list and remove their keys."""
        before = self.revoked()
        today = _today()
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self._certificate.subject)
            .last_update(today - timedelta(days=1))
            .next_update(_validity(self._certificate)[1])
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
        )
        entries = {entry.serial_number: entry for entry in before or ()}
        for name in names:
            path = f"sros2/{name}/cert.pem"
            serial = self._read_certificate(path, self._keys.read(path) or b"").serial_number
            entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(today).build()
            entries.setdefault(serial, entry)
        for entry in entries.values():
            builder = builder.add_revoked_certificate(entry)
        revoked = builder.add_extension(x509.CRLNumber(len(entries)), critical=False).sign(self._key, hashes.SHA256())
        # Write the list before removing keys: a certificate that no longer exists cannot be revoked.
        self._keys.write(_REVOKED, revoked.public_bytes(serialization.Encoding.PEM))
        for name in names:
            self._keys.remove(f"sros2/{name}")

    def entity(self, name: str, path: str) -> tuple[bytes, bytes, Certificate]:
        """Return the private key of an enclave in PEM, and its certificate in PEM and as an object."""
        key, secret = self._kept_key(_key_of(name))
        pem, certificate = self._kept_certificate(
            f"sros2/{name}/cert.pem", lambda: self._issue(path, secret, self._certificate)
        )
        if certificate.public_key() != secret.public_key() or not self._has_issued(certificate):
            folder = self._keys.folder / "sros2"
            raise InputError(
                f"{folder / name / 'cert.pem'} does not match its key or the authority; restore the folder {folder}, "
                "or remove it and deploy to all hosts again"
            )
        return key, pem, certificate

    def secret(self, name: str) -> EllipticCurvePrivateKey:
        """Return the private key of an enclave."""
        return self._kept_key(_key_of(name))[1]

    def signed(self, name: str, text: str) -> bytes:
        """Return a text as a signed S/MIME message."""
        content = text.encode()
        signature = self._keys.read(f"sros2/{name}.p7s")
        if signature is None or self._keys.read(f"sros2/{name}.xml") != content:
            options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
            builder = pkcs7.PKCS7SignatureBuilder().set_data(content)
            builder = builder.add_signer(self._certificate, self._key, hashes.SHA256())
            signature = builder.sign(serialization.Encoding.SMIME, options)
            # Write the text last: a signature without its text is not reused.
            self._keys.write(f"sros2/{name}.xml", b"")
            self._keys.write(f"sros2/{name}.p7s", signature)
            self._keys.write(f"sros2/{name}.xml", content)
        return signature

    def _has_issued(self, certificate: Certificate) -> bool:
        try:
            certificate.verify_directly_issued_by(self._certificate)
        except (InvalidSignature, TypeError, ValueError):
            return False
        return True

    def _kept_key(self, name: str) -> tuple[bytes, EllipticCurvePrivateKey]:
        content = self._keys.kept(name, _new_key)
        try:
            key = load_pem_private_key(content, None)
        except (TypeError, ValueError) as error:
            raise InputError(f"{self._keys.folder / name} does not contain a private key; {_RESTORE}") from error
        if not isinstance(key, EllipticCurvePrivateKey):
            raise InputError(f"{self._keys.folder / name} contains a key that is not an elliptic-curve key; {_RESTORE}")
        return content, key

    def _kept_certificate(self, name: str, make: Callable[[], bytes]) -> tuple[bytes, Certificate]:
        content = self._keys.kept(name, make)
        return content, self._read_certificate(name, content)

    def _read_certificate(self, name: str, content: bytes) -> Certificate:
        try:
            return load_pem_x509_certificate(content)
        except ValueError as error:
            raise InputError(f"{self._keys.folder / name} does not contain a certificate; {_RESTORE}") from error

    def _issue(self, name: str, key: EllipticCurvePrivateKey, issuer: Certificate | None) -> bytes:
        """Return a new certificate in PEM: for an enclave, or for the authority itself if `issuer` is None."""
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        # Valid from yesterday, so that a robot whose clock is slightly slow accepts it.
        today = _today()
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
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
        )
        if issuer is None:
            builder = builder.add_extension(_OF_AUTHORITY, critical=True)
        return builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def _key_of(name: str) -> str:
    return f"sros2/{name}/key.pem"


def _today() -> datetime:
    return datetime.now(timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0)


def _validity(certificate: Certificate) -> tuple[datetime, datetime]:
    """Return the validity period of a certificate; cryptography in Ubuntu 24.04 has other names for the two times."""
    if hasattr(certificate, "not_valid_after_utc"):
        return certificate.not_valid_before_utc, certificate.not_valid_after_utc
    first, last = certificate.not_valid_before, certificate.not_valid_after
    return first.replace(tzinfo=timezone.utc), last.replace(tzinfo=timezone.utc)


def _new_key() -> bytes:
    return ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
