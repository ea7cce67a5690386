#!/usr/bin/env bash
# Installs the libraries that MuJoCo's EGL rendering needs where they are missing: as root through apt-get, else
# it says which command does so and goes on, since everything that renders nothing works without them.
set -euo pipefail

missing=()
for package in libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0; do
    dpkg-query --show --showformat='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
        missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
    exit 0
fi

by_hand="apt-get update && apt-get install --yes --no-install-recommends ${missing[*]}"
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    echo "Installing ${missing[*]} (rendering) ..."
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq && apt-get install -qq --yes --no-install-recommends "${missing[@]}" >/dev/null && exit 0
fi
echo "Rendering needs system libraries; install them as root: $by_hand" >&2
