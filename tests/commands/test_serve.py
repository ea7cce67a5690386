"""`gloves serve`: LeRobot's policy server with a wrapped policy, asked by LeRobot's own client for the toy robot."""

import re
import signal
import socket
import subprocess
import threading
import time

import pytest
import torch
from lerobot.configs import PreTrainedConfig

from lerobot_gloves.commands import main
from lerobot_gloves.commands.serve import plugin_policies
from lerobot_policy_gloves.gloves.configuration_gloves import GlovesConfig
from lerobot_policy_gloves.gloves.modeling_gloves import GlovesPolicy
from tests.builders import save_policy, wrap
from tests.policies.toyrobot import INPUTS, JOINTS, OUTPUTS, ToyRobot, ToyRobotConfig
from tests.preloaded import server

CHUNK = 4
"""Actions that the client asks for, of the 6 that the agent proposes."""


@pytest.fixture
def served(tmp_path):
    """A saved wrapper, the address of a server, and its log, which is complete once the server was interrupted."""
    pytest.importorskip("grpc")
    features = {"input_features": INPUTS, "output_features": OUTPUTS}
    agent = save_policy(tmp_path / "agent", "gloves_expert_flow", **features)
    adapter = save_policy(tmp_path / "adapter", "gloves_expert_flow", seed=7, **features)
    wrap(agent, adapter=adapter).save_pretrained(tmp_path / "wrapper")
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    log = tmp_path / "log"
    command = [server() / "gloves", "serve", f"--port={port}", "--fps=50", "--inference_latency=0"]
    with log.open("w") as stream:
        process = subprocess.Popen(command, cwd=tmp_path, stdout=stream, stderr=subprocess.STDOUT)
    try:
        deadline = time.monotonic() + 300
        while "PolicyServer started" not in log.read_text():
            assert process.poll() is None and time.monotonic() < deadline, log.read_text()
            time.sleep(0.05)
        yield tmp_path / "wrapper", f"localhost:{port}", log
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)
    assert "Traceback" not in log.read_text()
    assert re.search(r"gloves: \d+ chunks, 100\.0 % edited, .* of a control period of 20\.0 ms", log.read_text())


@pytest.mark.slow
def test_the_clients_robot_gets_the_chunks_of_the_wrapper(served, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # LeRobot begins ./logs
    from lerobot.async_inference.configs import RobotClientConfig
    from lerobot.async_inference.robot_client import RobotClient

    wrapper, address, log = served
    client = RobotClient(
        RobotClientConfig(
            policy_type="gloves",
            pretrained_name_or_path=str(wrapper),
            robot=ToyRobotConfig(steps=10),
            server_address=address,
            actions_per_chunk=CHUNK,
            chunk_size_threshold=0.0,
            aggregate_fn_name="latest_only",
            task="move",
            fps=50,
        )
    )
    seen, received = {}, []
    send, aggregate = client.send_observation, client._aggregate_action_queues
    monkeypatch.setattr(
        client, "send_observation", lambda one: seen.update({one.get_timestamp(): one.get_observation()}) or send(one)
    )
    monkeypatch.setattr(
        client, "_aggregate_action_queues", lambda actions, how: received.append(actions) or aggregate(actions, how)
    )
    assert client.start()
    thread = threading.Thread(target=client.receive_actions)
    thread.start()
    with pytest.raises(KeyboardInterrupt):  # by which the robot ends its program
        client.control_loop("move")
    client.shutdown_event.set()
    thread.join(30)
    client.stop()
    assert len(received) >= 3 and len(ToyRobot.sent) == 10
    direct = GlovesPolicy.from_pretrained(wrapper)
    bare = GlovesPolicy.from_pretrained(wrapper)
    bare._corrector = None
    for actions in received:
        joints = seen[actions[0].get_timestamp()]
        observation = {"observation.state": torch.tensor([[joints[joint] for joint in JOINTS]]), "task": ["move"]}
        expected = direct.predict_action_chunk(observation)[0, :CHUNK]
        torch.testing.assert_close(torch.stack([one.get_action() for one in actions]), expected)
        assert not torch.isclose(expected, bare.predict_action_chunk(observation)[0, :CHUNK]).any()
    torch.testing.assert_close(torch.tensor(ToyRobot.sent[:CHUNK]), torch.stack([a.get_action() for a in received[0]]))
    assert "gloves: agent " in log.read_text()


def test_plugins_are_allowed_and_lerobots_list_stays_its_own():
    known = plugin_policies()
    assert {"gloves", "gloves_expert_flow", "gloves_copilot", "ddpm_assist", "csa_assist"} <= known
    assert known <= set(PreTrainedConfig.get_known_choices()) and not known & {"act", "xvla", "smolvla"}


def test_a_client_that_names_no_wrapper_is_told(tmp_path):
    with pytest.raises(ValueError, match=r"is a policy of type 'act', no saved wrapper$"):
        GlovesPolicy.from_pretrained(save_policy(tmp_path / "agent", "act"))


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("--fps=0", "gloves serve: fps is 0, but must be at least 1"),
        ("--port=80000", "gloves serve: port is 80000, but must lie between 1 and 65535"),
        ("--obs_queue_timeout=-1", "gloves serve: obs_queue_timeout is -1.0, but must not be negative"),
    ],
)
def test_bad_input_is_one_line(monkeypatch, option, told):
    monkeypatch.setattr("sys.argv", ["gloves", "serve", option])
    with pytest.raises(SystemExit) as error:
        main()
    assert str(error.value) == told


def test_an_address_of_somebody_else_is_one_line(monkeypatch, tmp_path):
    pytest.importorskip("grpc")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(GlovesConfig, "control_period", None)  # which serving sets for the whole program
    monkeypatch.setattr("sys.argv", ["gloves", "serve", "--host=192.0.2.1"])
    with pytest.raises(SystemExit, match=r"^gloves serve: cannot listen at 192\.0\.2\.1:8080: ") as error:
        main()
    assert "\n" not in str(error.value)


def test_what_is_missing_is_one_line(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "lerobot.async_inference", None)
    monkeypatch.setattr("sys.argv", ["gloves", "serve"])
    with pytest.raises(SystemExit, match=r"pip install 'lerobot_policy_gloves\[serve\]'$"):
        main()
