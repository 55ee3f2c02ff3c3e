#!/usr/bin/env bash
# Install what is in dist/ into an empty environment, and find a site with it, away from the checkout.
set -eu
python=$1
dist=$(cd "$(dirname "$0")/../dist" && pwd)
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT
cd "$away"
unset PYTHONPATH
"$python" -m venv env
for package in "$dist"/*.tar.gz "$dist"/*.whl; do
  env/bin/python -m pip install --quiet --force-reinstall "$package"
  env/bin/alight --version
done
env/bin/alight simulate demo --duration 3 --out flight
env/bin/alight run flight --out found
test -s found/report.html
test -s found/sites.geojson
