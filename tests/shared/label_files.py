"""Files with the answers of a person, as a page of labels saves them."""

import csv
from collections.abc import Sequence
from pathlib import Path

from nrbench.labelling.labels import LabelPage


def write_answers(path: Path, page: LabelPage, answers: Sequence[Sequence[str]]) -> Path:
    """Write the answers to all questions about each item."""
    rows = [
        [item.id, question, answer, 1.5, i, "person"]
        for i, (item, said) in enumerate(zip(page.items, answers, strict=True), 1)
        for question, answer in zip(page.questions, said, strict=True)
    ]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([["item", "question", "answer", "seconds", "order", "labeled_by"], *rows])
    return path
