#!/bin/sh
# From nothing to the table of a paper.
#   sh benchmarks/paper_table.sh [RUN] [FILE.py METHOD] [SUITE]
# It runs SUITE (default: default) with its methods, and METHOD of FILE.py beside them if these are given. Then it writes the
# tables as LaTeX, the perils plane as PDF in the width of a column, and the BibTeX entries of the methods to RUN/paper.
set -eu
run=${1:-runs/paper}
file=${2:-}
method=${3:-}
suite=${4:-default}
nrbench=${NRBENCH:-nrbench}

if [ -n "$file" ]; then
  if [ -f "$suite" ]; then cat "$suite"; else "$nrbench" show "$suite" --toml; fi > "${TMPDIR:-/tmp}/suite-$$.toml"
  # Each method is quoted, because the command of another program holds spaces.
  methods=$(python3 -c '
import shlex, sys, tomllib
print(*("-m " + shlex.quote(name) for name in tomllib.load(open(sys.argv[1], "rb")).get("methods", [])))' "${TMPDIR:-/tmp}/suite-$$.toml")
  rm "${TMPDIR:-/tmp}/suite-$$.toml"
  eval "set -- $methods"
  "$nrbench" --plugin "$file" run "$suite" "$@" -m "$method" --out "$run"
else
  "$nrbench" run "$suite" --out "$run"
fi
"$nrbench" ${file:+--plugin "$file"} report "$run" --format latex,perils:width=3.4,csv

mkdir -p "$run/paper"
cp "$run"/tables/*.tex "$run"/tables/*.bib "$run/paper/"
# There is no plane if no output has a quality.
if [ -f "$run/report/perils.pdf" ]; then cp "$run/report/perils.pdf" "$run/paper/"; fi
echo "the files of the paper: $run/paper"
