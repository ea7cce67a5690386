#!/usr/bin/env bash
# Installs the browser in which the page of `gloves drive` is tested, and its driver, where they are missing: as root
# through Debian's apt-get, else it says what to install and goes on, since without them only those tests are skipped.
set -euo pipefail

if command -v chromedriver >/dev/null && { command -v chromium || command -v google-chrome; } >/dev/null; then
    exit 0
fi
packages=(chromium chromium-driver)
if [ "$(id -u)" -eq 0 ] && command -v apt-get >/dev/null; then
    echo "Installing ${packages[*]} (browser tests) ..."
    export DEBIAN_FRONTEND=noninteractive
    apt-get update -qq && apt-get install -qq --yes --no-install-recommends "${packages[@]}" >/dev/null && exit 0
fi
echo "The browser tests need Chromium or Google Chrome, and chromedriver (Debian, as root: apt-get install ${packages[*]})" >&2
