"""Run a command and keep what it printed as a row of docs/results.md.

python scripts/measure.py --title="Editing" --output=docs/rows/editing.json python scripts/benchmark_editing.py
"""

import argparse
import json
import platform
import shlex
import subprocess
import sys
from pathlib import Path


def main() -> None:
    """Run, show and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--title", required=True, help="heading in docs/results.md")
    parser.add_argument("--output", type=Path, required=True, help="file in docs/rows/")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what to run")
    arguments = parser.parse_args()
    program = [sys.executable if arguments.command[0] == "python" else arguments.command[0], *arguments.command[1:]]
    done = subprocess.run(program, check=True, stdout=subprocess.PIPE, text=True)
    print(done.stdout, end="")
    row = {
        "title": arguments.title,
        "command": shlex.join(arguments.command),
        "machine": platform.machine(),
        "printed": done.stdout.strip(),
    }
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(json.dumps(row, indent=1) + "\n")


if __name__ == "__main__":
    main()
