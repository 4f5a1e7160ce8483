"""Nothing in nrbench unpickles, evaluates text, starts a shell, or opens a connection, except where it says so."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = ("nrbench", "synthesizers", "metrics", "datasets_procedural", "reports")
MODULES = {
    *("pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve"),
    *("socket", "ssl", "http", "urllib", "requests", "httpx", "aiohttp", "ftplib", "smtplib", "telnetlib", "xmlrpc"),
    *("code", "codeop", "pty"),
}
CALLS = {"eval", "exec", "compile", "__import__"}
METHODS = {"system", "popen", "execv", "execve", "execvp", "read_pickle", "to_pickle", "loads_pickle", "urlopen"}


def risks(text: str) -> Iterator[str]:
    """Yield each import and call of a source text that may run or fetch what a file or a stranger says."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (f"import {alias.name}" for alias in node.names if alias.name.split(".")[0] in MODULES)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            if (node.module or "").split(".")[0] in MODULES:
                yield f"from {node.module} import"
        elif isinstance(node, ast.Call):
            yield from _risky_call(node)


def _risky_call(node: ast.Call) -> Iterator[str]:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    method = node.func.attr if isinstance(node.func, ast.Attribute) else ""
    if name in CALLS or method in METHODS:
        yield f"{name or method}()"
    for keyword in node.keywords:
        on = isinstance(keyword.value, ast.Constant) and keyword.value.value is True
        if keyword.arg in ("shell", "allow_pickle") and (on or not isinstance(keyword.value, ast.Constant)):
            yield f"{keyword.arg}="
    arrays = (
        isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name) and node.func.value.id == "np"
    )
    if arrays and method == "load" and "allow_pickle" not in {keyword.arg for keyword in node.keywords}:
        yield "np.load() without allow_pickle=False"


def test_the_sources_take_no_risks() -> None:
    """No module of nrbench imports pickle or a network library, evaluates text, or starts a shell."""
    found = {
        f"{file.relative_to(ROOT)}: {risk}"
        for folder in SOURCES
        for file in (ROOT / folder).rglob("*.py")
        for risk in risks(file.read_text("utf-8"))
    }
    assert found == set()


def test_each_risk_is_seen() -> None:
    """The test sees what it looks for."""
    lines = (
        *("import pickle", "from urllib.request import urlopen", "import http.client", "eval(x)", "exec(x)"),
        *("os.system(x)", "subprocess.run(x, shell=True)", "subprocess.run(x, shell=y)", "np.load(x)"),
        *("np.load(x, allow_pickle=True)", "pd.read_pickle(x)"),
    )
    assert [line for line in lines if not list(risks(line))] == []
    assert list(risks("re.compile(x)\nspec.loader.exec_module(m)\nnp.load(x, allow_pickle=False)")) == []
