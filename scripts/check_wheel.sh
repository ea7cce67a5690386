#!/usr/bin/env bash
# Builds the sdist and, from it, the wheel into dist/, checks both, and installs the wheel as a user would, far from this
# checkout: without extras, where the plugin must load and `gloves` must answer, then with Slalom's and the page's, for
# `gloves demo` and `gloves drive`.
# Needs Python 3.12 or later (python3.12 or python3), a package index, and about 8 GB under $TMPDIR for as long as it runs.
set -euo pipefail
cd "$(dirname "$0")/.."

for python in python3.12 python3; do
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null && break
done
room=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$room"' EXIT

echo "Building ..."
rm -rf dist
"$python" -m venv "$room/build"
"$room/build/bin/pip" install --quiet --disable-pip-version-check build twine
"$room/build/bin/python" -m build --outdir dist . >"$room/build.log" || { cat "$room/build.log"; exit 1; }
"$room/build/bin/twine" check --strict dist/*
wheel=$(echo "$PWD"/dist/*.whl)
ls -l dist

echo "Installing the wheel into a bare environment ..."
"$python" -m venv "$room/bare"
export PATH="$room/bare/bin:$PATH"
unset PYTHONPATH
cd "$room"
pip install --quiet --disable-pip-version-check "$wheel"
pip check
python -c '
import importlib
from importlib.resources import files

import lerobot_policy_gloves
from lerobot.configs import PreTrainedConfig
from lerobot.envs import EnvConfig

for name in ("gloves", "gloves_expert_flow", "gloves_align_flow", "gloves_copilot", "gloves_flow_policy", "gloves_person", "ddpm_assist", "csa_assist"):
    PreTrainedConfig.get_choice_class(name)
EnvConfig.get_choice_class("gloves_slalom")
assert files("lerobot_gloves").joinpath("drive/page/page.html").is_file()
for name in ("lerobot_gloves", "gloves_flow", *(f"lerobot_policy_{one}" for one in ("gloves", "ddpm_assist", "csa_assist"))):
    assert files(importlib.import_module(name)).joinpath("py.typed").is_file(), name
'
gloves --help

echo "Adding the extras slalom and drive ..."
pip install --quiet --disable-pip-version-check "$wheel[slalom,drive]"
MUJOCO_GL=${MUJOCO_GL:-egl} gloves demo --episodes=4 --output_dir=demo
ls -l demo

MUJOCO_GL=${MUJOCO_GL:-egl} gloves drive --env.type=gloves_slalom --port=0 >drive.log 2>&1 &
server=$!
until grep -q "http://" drive.log; do
    kill -0 "$server" || { cat drive.log; exit 1; }
    sleep 1
done
python -c '
import re
import urllib.request

address = re.search(r"http://\S+", open("drive.log").read())[0]
page = urllib.request.urlopen(address).read().decode()
assert "<title>" in page, page
print("gloves drive answers at", address)
'
kill "$server"
cat drive.log
