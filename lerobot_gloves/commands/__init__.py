"""The `gloves` command, whose commands are modules beside this one."""

import importlib
import sys

COMMANDS = {
    "record": "record a task's scripted expert, an agent, or a person at a robot, as a LeRobotDataset",
    "calibrate": "score held-out expert episodes with a trained adapter and store the calibration",
    "check": "see whether a trained adapter can tell an expert's chunks from others",
    "tune": "choose an adapter's method and gate without a simulator",
    "push": "upload a trained checkpoint with its calibration and its card",
    "bench": "run perturbation x method x seed on a task",
    "demo": "see an imperfect policy get better",
    "drive": "drive a robot yourself, in the browser, and see your commands corrected",
    "teleoperate": "teleoperate a robot as by lerobot-teleoperate, and have your commands corrected",
    "serve": "run LeRobot's policy server, which then knows wrapped policies",
    "replay": "scrub through the episodes of a log, and see every edit",
    "report": "turn benchmark rows into tables and plots",
}


def main() -> None:
    """Run the command that the first argument names; it reads the others itself."""
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in ("--help", "-h"):
        width = max(map(len, COMMANDS))
        lines = [f"  {command:<{width}}  {purpose}" for command, purpose in COMMANDS.items()]
        print("\n".join(["usage: gloves COMMAND [--help] [--option=value ...]", "", *lines]))
        return
    if name not in COMMANDS:
        sys.exit(f"gloves: there is no command {name!r}: choose one of {', '.join(COMMANDS)}")
    # LeRobot's parser reads sys.argv, as if each command were a program of its own.
    sys.argv = [f"gloves {name}", *arguments]
    importlib.import_module(f"lerobot_gloves.commands.{name}").main()
