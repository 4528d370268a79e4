"""Signatures of states, and the files of their keys."""

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from hypothesis import given, strategies as st

from swarmabs_config.seals import EcdsaSeals, opened, public_keys
from swarmabs_core.errors import InputError
from swarmabs_core.messages import NEVER, PARENT, AgentState, PlaneState
from swarmabs_core.parameters import SettingError
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.relayed import SIGNATURE
from swarmabs_core.realtime.seals import SealFiles, author_of, signed_content

CURVE = ec.SECP256R1()
KEYS = {author: ec.derive_private_key(7 + author, CURVE) for author in (PARENT, 1, 2)}
PUBLIC = {author: key.public_key() for author, key in KEYS.items()}
CLOCK = Schedule(20_000_000, 1_700_000_000_000_000_000)
numbers = st.floats(-1e3, 1e3)
robots = st.builds(
    AgentState,
    st.integers(0, 2**60),
    st.integers(0, 2**32),
    st.sampled_from([NEVER, 5]),
    st.sampled_from([1, 2]),
    st.integers(1, 2),
    st.integers(1, 3),
    numbers,
    numbers,
    numbers,
    numbers,
    numbers,
)
planes = st.builds(PlaneState, st.integers(0, 2**60), st.integers(0, 2**32), numbers, numbers)
NOT_SIGNED = {"stamp", "command"}


@given(robots | planes)
def test_a_signature_holds_for_its_author_and_content_only(state: AgentState | PlaneState) -> None:
    author = author_of(state)
    seals = EcdsaSeals(KEYS[author], PUBLIC)
    content = signed_content(state, CLOCK)
    signature = seals.sign(content)
    assert len(signature) == SIGNATURE
    assert [other for other in (*KEYS, 3) if seals.holds(other, content, signature)] == [author]
    assert not seals.holds(author, content, signature[:-1])
    assert not seals.holds(author, content, bytes(SIGNATURE))
    assert not seals.holds(author, content + b"\0", signature)


@given(robots)
def test_all_that_is_passed_on_of_a_robot_is_signed(state: AgentState) -> None:
    """Neither the stamp nor the command is passed on, nor which broadcasts a robot follows, only whether."""
    content = signed_content(state, CLOCK)
    for name in AgentState._fields:
        value = getattr(state, name)
        changed = state._replace(**{name: NEVER if name == "broadcast_step" and value != NEVER else value + 1})
        assert (signed_content(changed, CLOCK) == content) == (name in NOT_SIGNED)
    assert signed_content(state, Schedule(CLOCK.period_ns, 0)) != content
    assert author_of(state._replace(agent_id=2)) == 2


def files_in(folder: Path, key: bytes | None = None, keys: str | None = None) -> SealFiles:
    private = KEYS[1].private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()) if key is None else key
    (folder / "key.pem").write_bytes(private)
    (folder / "keys").write_text(public_keys(PUBLIC) if keys is None else keys, encoding="ascii")
    return SealFiles(str(folder / "key.pem"), str(folder / "keys"))


def test_what_is_in_files_is_used(tmp_path: Path) -> None:
    seals = opened(files_in(tmp_path), 1)
    assert seals.holds(1, b"text", EcdsaSeals(KEYS[1], {}).sign(b"text"))
    assert EcdsaSeals(KEYS[2], PUBLIC).holds(1, b"text", seals.sign(b"text"))


EDWARDS = ed25519.Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


@pytest.mark.parametrize(
    ("key", "keys", "problem"),
    [
        (b"no key", None, "key.pem does not contain a private key"),
        (EDWARDS, None, "key.pem contains a key that is not one of P-256"),
        (None, "1 00\n", "keys, line 1: not a number and a public key"),
        (None, f"{public_keys(PUBLIC)}2 3 4\n", "keys, line 4: not a number"),
        (None, "ü\n", "keys, line 1: not a number"),
        (None, "", "key.pem is not the key of robot 1 in"),
        (None, public_keys({1: PUBLIC[2]}), "key.pem is not the key of robot 1 in"),
    ],
)
def test_damaged_files_and_those_of_others_are_refused(
    tmp_path: Path, key: bytes | None, keys: str | None, problem: str
) -> None:
    files = files_in(tmp_path, key)
    if keys is not None:
        (tmp_path / "keys").write_text(keys, encoding="utf-8")
    with pytest.raises(InputError, match=f"{problem}.*; install the bundle of this host again"):
        opened(files, 1)
    files_in(tmp_path)
    opened(files, 1)


@pytest.mark.parametrize("name", ["key.pem", "keys"])
def test_files_that_cannot_be_read_are_refused(tmp_path: Path, name: str) -> None:
    files = files_in(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(InputError, match=f"{name} cannot be read: No such file or directory; install"):
        opened(files, 1)


@pytest.mark.parametrize("given", ["key", "keys"])
def test_one_file_needs_the_other(given: str) -> None:
    with pytest.raises(SettingError, match="it is empty"):
        SealFiles(**{given: "file"})
