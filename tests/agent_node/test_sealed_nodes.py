"""Robots and planes of sealed swarms as nodes: their endpoints, and what happens without usable keys."""

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from tests.swarmabs_ros.nodes import COMMAND_LINE, given

from agent_node import realtime_peer
from plane_sim import driver, realtime
from swarmabs_config.graph import PEER, PLANE, PLANE_DRIVER, REALTIME, Option, endpoints
from swarmabs_config.seals import public_keys
from swarmabs_core.messages import PARENT, PLANE_STATE, relay_topic

NODES = {PEER: realtime_peer.main, PLANE: realtime.main, PLANE_DRIVER: driver.main}


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("name", NODES)
def test_a_node_whose_keys_cannot_be_used_ends_with_exit_code_2(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    key = ec.derive_private_key(7, ec.SECP256R1())
    keys = tmp_path / "keys"
    keys.write_text(public_keys({5: key.public_key()}), encoding="ascii")
    own = tmp_path / "key.pem"
    who = "robot 1" if name == PEER else "the plane"
    parameters = given(seal__key=str(own), seal__keys=str(keys))
    assert NODES[name]([*COMMAND_LINE, *parameters]) == 2
    assert f"error: {own} cannot be read: No such file or directory; install the bundle" in capfd.readouterr().err
    own.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    assert NODES[name]([*COMMAND_LINE, *parameters]) == 2
    assert f"error: {own} is not the key of {who} in {keys}; install the bundle" in capfd.readouterr().err


@pytest.mark.parametrize("plane", [PLANE, PLANE_DRIVER])
def test_robots_of_a_sealed_swarm_hear_the_plane_where_it_signs(plane: str) -> None:
    sensing, sealed = frozenset({Option.SENSING}), frozenset({Option.SEALED})
    signed = relay_topic(PARENT)
    assert signed in endpoints(plane, REALTIME, sealed).publications
    assert signed not in endpoints(plane, REALTIME).publications
    for options, heard in ((sensing, {PLANE_STATE}), (sensing | sealed, {signed}), (sealed, set())):
        ends = endpoints(PEER, REALTIME, options, members=(1,), neighbours=(2,))
        assert ends.subscriptions.keys() & {PLANE_STATE, signed} == heard
        assert relay_topic(2) in ends.subscriptions
        assert relay_topic(1) in ends.publications
