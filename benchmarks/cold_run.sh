#!/usr/bin/env bash
# The time of `make run` from nothing: a fresh clone, no environment and no compiled kernels, for each of some commits.
# bash benchmarks/cold_run.sh COMMIT [COMMIT ...]    prints wall, user and system seconds of each, in this order
set -euo pipefail
tree=$(git rev-parse --show-toplevel)
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
export PIP_CACHE_DIR=${PIP_CACHE_DIR:-$HOME/.cache/pip}
unset PYTHONDONTWRITEBYTECODE PYTHONSAFEPATH
for commit in "$@"; do
  git clone --quiet "$tree" "$place/tree"
  git -C "$place/tree" checkout --quiet "$commit"
  TIMEFORMAT="$commit: %R s wall, %U s user, %S s system"
  time XDG_CACHE_HOME="$place/cache" make -C "$place/tree" run > "$place/log" 2>&1
  rm -rf "$place/tree" "$place/cache"
done
