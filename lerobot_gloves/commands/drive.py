"""`gloves drive`: a person at the controls, in the browser."""

import secrets
import shlex
import socket
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from lerobot.configs import parser
from lerobot.envs import EnvConfig, preprocess_observation

from lerobot_gloves.commands.assisting import AssistanceConfig
from lerobot_gloves.commands.errors import one_line_errors
from lerobot_gloves.commands.start import start
from lerobot_gloves.demo import PACKAGED, PERSONS_COPILOT
from lerobot_gloves.drive.assistance import Assistance, load_assistance
from lerobot_gloves.drive.board import Board
from lerobot_gloves.drive.desk import Desk
from lerobot_gloves.drive.loop import run
from lerobot_gloves.drive.session import Driven, Session, Step
from lerobot_gloves.drive.view import View, view_of
from lerobot_gloves.evaluation.environments import environments
from lerobot_gloves.evaluation.seeds import ALL
from lerobot_gloves.system.display import Display
from lerobot_gloves.system.errors import one_line
from lerobot_gloves.system.locks import alone_with

SHIPPED = {"gloves_slalom": PACKAGED / PERSONS_COPILOT}
"""The adapter that ships with the package, by `--env.type`."""


@dataclass
class DriveConfig:
    """Drive a task's robot yourself, in the browser, and see what an adapter makes of your commands.

    gloves drive --env.type=gloves_slalom
    """

    # The task.
    env: EnvConfig
    # What corrects you.
    policy: AssistanceConfig = field(default_factory=AssistanceConfig)
    # Address to listen at. Any other than this computer's own lets whoever reaches it and has the printed address
    # watch, and drive while nobody does; 0.0.0.0 is every address that this computer has.
    host: str = "127.0.0.1"
    # Port to listen at; 0 takes a free one.
    port: int = 8765
    # Height and width of the camera's picture, in pixels; where the adapter sees pictures, --env.image_size says it.
    view: int = 480
    # Seed of the first episode; that of a benchmark is its episode again.
    seed: int = ALL
    # The fault to drive against to begin with, by its name on the page; the page changes it.
    fault: str = "none"
    # How many episodes to play as a study, an even number: half of them without assistance, in random order, blind.
    study: int | None = None
    # Folder of the study: its episodes, results and dataset. Run again, it goes on where it stopped.
    output_dir: Path | None = None
    # Whether to show every step in rerun, LeRobot's viewer: observation, your command, the executed action, score and
    # p-value.
    display_data: bool = False
    # Address of a viewer that runs already; by default one is opened here.
    display_ip: str | None = None
    # Port of that viewer.
    display_port: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}, but must lie between 0 and 65535")
        if not 64 <= self.view <= 2048:
            raise ValueError(f"view is {self.view}, but must lie between 64 and 2048")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}, but must not be negative")
        if self.study is not None and (self.study < 2 or self.study % 2):
            raise ValueError(f"study is {self.study}, but must be an even number of episodes, at least 2")
        if (self.study is None) != (self.output_dir is None):
            raise ValueError("a study needs a folder: give both --study and --output_dir, or neither")
        view_of(self.env)
        if self.policy.adapter is None and self.env.type in SHIPPED:
            self.policy.adapter = str(SHIPPED[self.env.type])
        if getattr(self.env, "obs_type", None) == "state":
            self.env.image_size = self.view


@parser.wrap()
def drive(config: DriveConfig) -> None:
    """Serve until interrupted.

    Raises:
        ImportError: If Starlette or uvicorn is not installed.
        ConnectionError: If it cannot listen at that address.
        BlockingIOError: If another process plays the same study.
    """
    try:
        from lerobot_gloves.drive.server import Site, is_loopback, serving
    except ImportError as error:
        raise ImportError(f"{one_line(error)}: pip install 'lerobot_policy_gloves[drive]'") from error
    torch.set_num_threads(1)  # a step's networks are small: more threads would only wait for one another
    view = view_of(config.env)
    options: dict[str, Any] = asdict(config.policy)
    device = options.pop("device")
    token = None if is_loopback(config.host) else secrets.token_urlsafe(16)
    with listening(config.host, config.port) as listener, _kept(config), environments(config.env, 1) as env:
        assistance = load_assistance(config.env, options, view.faults, device)
        assistance.choose(replace(assistance.settings, fault=config.fault))
        session, board = Session(env, view, assistance, config.seed), Board()
        if (display := Display.asked(config)) is not None:
            session.watchers.append(shown_in(display))
        driven = session if config.study is None else _study(config, session, view, assistance, options)
        scene = {
            **view.scene,
            "rate": config.env.fps,
            "faults": ["none", *view.faults],
            "adapter": assistance.adapter,
            "ungated": assistance.ungated,
        }
        with serving(Site(Desk(driven), board, scene, token), listener):
            if assistance.adapter is None:
                print(f"gloves drive: nothing assists you: for {config.env.type} name an adapter by --policy.adapter")
            print(f"gloves drive: open {address(config.host, listener.getsockname()[1], token)}", flush=True)
            if token is not None:
                print(
                    f"gloves drive: {config.host} is open to the network, unencrypted: "
                    "whoever has this address can watch, and drive while nobody else does",
                    flush=True,
                )
            run(driven, config.env.fps, board.publish, over=lambda: False)


def _study(
    config: DriveConfig, session: Session, view: View, assistance: Assistance, options: dict[str, Any]
) -> Driven:
    from lerobot_gloves.drive.study_opening import open_study  # its datasets and plots take seconds to import

    assert config.study is not None and config.output_dir is not None
    how: dict[str, Any] = {"root": config.output_dir, "episodes": config.study, "seed": config.seed}
    typed = " ".join([sys.argv[0], *map(shlex.quote, sys.argv[1:])])
    return open_study(config.env, session, view, assistance, **how, options=options, command=typed)


def _kept(config: DriveConfig) -> AbstractContextManager[None]:
    """Keeps a study's folder from other processes."""
    if config.output_dir is None:
        return nullcontext()
    return alone_with(config.output_dir, f"{config.output_dir} is the folder of a study that runs: choose another one")


def shown_in(display: Display) -> Callable[[Step], None]:
    """Shows every step of a session in LeRobot's viewer: the command as proposal, and what became of it."""

    def show(step: Step) -> None:
        command, executed = (torch.from_numpy(action)[None] for action in (step.command, step.acted.action))
        display.show(preprocess_observation(step.observation), command, executed, step.acted.known)

    return show


def listening(host: str, port: int) -> socket.socket:
    """A socket that listens.

    Raises:
        ConnectionError: If it cannot.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host.strip("[]"), port), family=family)
    except OSError as error:
        raise ConnectionError(f"cannot listen at {host}:{port}: {one_line(error)}") from error


def address(host: str, port: int, token: str | None) -> str:
    """What to open in a browser."""
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    named = f"[{host}]" if ":" in host and not host.startswith("[") else host
    return f"http://{named}:{port}/" + ("" if token is None else f"?token={token}")


def main() -> None:
    """Entry point."""
    start()
    with one_line_errors("gloves drive"):
        drive()
