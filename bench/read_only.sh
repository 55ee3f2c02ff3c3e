#!/bin/sh
# A command of Alight as another user in a read-only image: no home, no /tmp, no /dev/shm, nothing writable but OUT.
#
#     sudo bench/read_only.sh OUT PYTHON demo --out OUT/demo
#
# PYTHON is an interpreter that has Alight. Needs Linux, root (for the mounts) and util-linux (unshare, setpriv).
set -eu
out=$(realpath "$1") python=$2
shift 2
chown nobody "$out"
image=$(mktemp -d)
trap 'rmdir "$image"' EXIT
unshare --mount --fork sh -c '
    set -eu
    image=$1 out=$2 python=$3 path=$4
    shift 4
    mount --make-rprivate /
    mount --bind / "$image"
    mount -o remount,ro,bind "$image"
    mount --bind /dev "$image/dev"
    mount -o remount,ro,bind "$image/dev"
    mount --bind "$out" "$image$out"
    exec chroot "$image" setpriv --reuid=nobody --regid=nogroup --clear-groups \
        env -i PATH=/usr/bin:/bin PYTHONPATH="$path" nice "$python" -c "from alight.cli import main; main()" "$@"
' sh "$image" "$out" "$python" "${PYTHONPATH:-}" "$@"
