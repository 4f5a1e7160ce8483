"""The questions that labelers answer about an output, and the automatic score that measures the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from nrbench.errors import BadInput
from nrbench.plugins.forms import Value
from nrbench.runs.records import CellRecord

ANSWERS = ("yes", "no", "cannot say")
"""The possible answers to every question, in the order of the keys 1, 2, 3."""
PRESERVED = "regularity.preserved"
WHOLE_SCORE = 0.95
"""``integrity.score`` below which elements are called broken: more than one in twenty is, beyond chance."""

Scores = Mapping[str, Value]


@dataclass(frozen=True)
class Question:
    """A question about an output.

    Parameters
    ----------
    name
        Its name in files and tables.
    text
        The question.
    meanings
        What yes and no mean.
    column
        The score that measures the same.
    rule
        The answer that the scores of a cell give: True for yes, False for no, None if it cannot be said. A question
        without a rule is about a matter of degree. No value of its score separates yes from no.
    """

    name: str
    text: str
    meanings: tuple[str, str]
    column: str
    rule: Callable[[Scores], bool | None] | None = None

    @property
    def metric(self) -> str:
        """The metric of the score."""
        return self.column.partition(".")[0]

    def automatic_answer(self, record: CellRecord) -> str | None:
        """Return the answer that the scores of a cell give, one of :data:`ANSWERS`; None without a rule."""
        if self.rule is None:
            return None
        answer = self.rule(record.values)
        return ANSWERS[2] if answer is None else ANSWERS[0] if answer else ANSWERS[1]


def _is_preserved(values: Scores) -> bool | None:
    preserved = values.get(PRESERVED)
    return None if preserved is None else bool(preserved)


def _has_whole_elements(values: Scores) -> bool | None:
    """Return whether nearly all elements are whole."""
    score = values.get("integrity.score")
    return None if score is None else score >= WHOLE_SCORE


LATTICE = Question(
    "lattice",
    "Is the lattice kept?",
    (
        "all elements of the output are in the pattern of the sample: none is missing, doubled, cut short or out of "
        "line. Judge their places, not their colors.",
        "the pattern is broken at some place; one element is enough.",
    ),
    PRESERVED,
    _is_preserved,
)
ELEMENTS = Question(
    "elements",
    "Are the elements whole?",
    (
        "each element looks like one piece, as in the sample.",
        "an element is cut, or joined of parts that do not belong together, such as a brick of two colors; one element "
        "is enough.",
    ),
    "integrity.score",
    _has_whole_elements,
)
MORE = Question(
    "more",
    "Does it look like more of the same?",
    (
        "the output could be another part of the same wall, cloth or floor.",
        "it could not: it is broken, repeats itself like wallpaper, is blurred, or looks different.",
    ),
    "quality.score",
)
QUESTIONS: Mapping[str, Question] = {question.name: question for question in (LATTICE, ELEMENTS, MORE)}
"""All questions by name, in the order in which a page asks them."""


def find_questions(names: Sequence[str]) -> list[Question]:
    """Return the questions with the given names.

    Raises
    ------
    BadInput
        When a name is unknown or given twice, or there is none.
    """
    known = ", ".join(QUESTIONS)
    unknown = next((name for name in names if name not in QUESTIONS), None)
    if unknown is not None or not names:
        raise BadInput(f"question {unknown or ''!r} is not known; use some of: {known}")
    if len(set(names)) < len(names):
        raise BadInput(f"questions {', '.join(names)}: one is given twice; name each question once")
    return [QUESTIONS[name] for name in names]
