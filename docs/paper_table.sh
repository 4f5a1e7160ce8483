#!/bin/sh
# From nothing to the table of a paper.
#   sh docs/paper_table.sh [RUN] [FILE.py METHOD] [SUITE]
# It runs SUITE (default: default) with its methods, and METHOD of FILE.py beside them if these are given. Then it writes the
# tables as LaTeX, the perils plane as PDF in the width of a column, and the BibTeX entries of the methods to RUN/paper.
set -eu
run=${1:-runs/paper}
file=${2:-}
method=${3:-}
suite=${4:-default}
nrbench=${NRBENCH:-nrbench}

if [ -n "$file" ]; then
  methods=$("$nrbench" show "$suite" --json | python3 -c '
import json, sys
print(*(f"-m {name}" for name in json.load(sys.stdin)[0]["methods"]))')
  # shellcheck disable=SC2086
  "$nrbench" --plugin "$file" run "$suite" $methods -m "$method" --out "$run"
else
  "$nrbench" run "$suite" --out "$run"
fi
"$nrbench" ${file:+--plugin "$file"} report "$run" --format latex,perils:width=3.4,csv

mkdir -p "$run/paper"
cp "$run"/tables/*.tex "$run/report/perils.pdf" "$run/paper/"
python3 - "$run" "$nrbench" > "$run/paper/methods.bib" <<'PYTHON'
import json
import subprocess
import sys
from pathlib import Path

info = json.loads((Path(sys.argv[1]) / "run.json").read_text("utf-8"))
names = sorted({cell["method"] for cell in info["cells"]})
for name in names:
    shown = subprocess.run([sys.argv[2], "show", name, "--json"], capture_output=True, text=True)
    for page in json.loads(shown.stdout or "[]"):
        if page["kind"] == "synthesizers" and page["bibtex"]:
            print(page["bibtex"] + "\n")
PYTHON
echo "the files of the paper: $run/paper"
