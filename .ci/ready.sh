#!/usr/bin/env bash
# Make a wheel that brings its compiled loops, for this minor version of Python on x86-64-v3: .ci/ready.sh PYTHON
set -eu
python=$(realpath -s "$1")
dist=$(cd "$(dirname "$0")/.." && pwd)/dist
away=$(mktemp -d)
trap 'rm -rf "$away"' EXIT
"$python" -m build --quiet --wheel --outdir "$away"
"$python" -m wheel unpack --dest "$away" "$away"/*.whl
(
  cd "$away"/alight-*/
  env -u NUMBA_CACHE_DIR XDG_CACHE_HOME="$away" PYTHONPATH="$PWD" \
    "$python" -c 'from alight.cli import main; main()' warmup
  ls "$away"/alight/kernels-*/warm-*-x86-64-v3-* >/dev/null  # else this processor is an older one
  mv "$away"/alight/kernels-* alight/loops
  find . -name __pycache__ -prune -exec rm -r {} + -o -name '*.turn' -exec rm {} +
)
"$python" -m wheel pack --dest-dir "$away" "$away"/alight-*/
tag=$("$python" -c 'import sys; print("cp%d%d" % sys.version_info[:2])')
mkdir -p "$dist"
mv "$away/$("$python" -m wheel tags --python-tag "$tag" --platform-tag linux_x86_64 "$away"/*.whl)" "$dist"
