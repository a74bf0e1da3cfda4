"""Refusals of the argument parser in one line: the rule, what was typed, and what helps."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

from toolkit.class_names import check_classes
from toolkit.objects import LABELS

COMMANDS_OF_COMMANDS = ("site",)  # commands with commands of their own
# words for one value and for several, by the parser's word
_KINDS = {
    "FLOAT": ("a number", "numbers"),
    "INT": ("a whole number", "whole numbers"),
    "PATH": ("a path", "paths"),
}


def describe_near(word: str, words: Sequence[str]) -> str:
    """Return the end of an error, which asks for the word that was meant; "" if none is similar.

    word: word that was typed; words: words that are allowed.

    >>> describe_near("evaluat", ["detect", "evaluate"])
    ': did you mean evaluate?'
    """
    matches = get_close_matches(word, words, n=1, cutoff=0.6)
    return f": did you mean {matches[0]}?" if matches else ""


@contextmanager
def record_refusals() -> Iterator[list[Any]]:
    """Yield a list to which the parser adds its refusals, as events.

    tyro's module of errors is private. If it no longer reports refusals, the list stays empty, and
    tyro's text is shown."""
    events: list[Any] = []
    try:
        from tyro._errors import on_parse_error
    except ImportError:
        yield events
        return
    with on_parse_error(events.append):
        yield events


def describe_refusal(event: Any, text: str, words: Sequence[str]) -> str | None:
    """Describe a refusal of the parser in one line; None for one of an unknown kind.

    event: tyro's refusal, whose class is its kind; text: what the parser printed; words: the
    command line."""
    command = "coview" if words[0].startswith("-") else words[0]
    if type(event).__name__ == "MissingArgs" and words[0] in COMMANDS_OF_COMMANDS:
        command = " ".join(words[:2])
    descriptions = {
        "UnrecognizedArgs": _describe_unknown,
        "InvalidChoice": _describe_choice,
        "InstantiationFailure": _describe_values,
        "BadValue": _describe_too_few,
        "MissingArgs": _describe_missing,
        "MissingSubcommand": _describe_missing_command,
    }
    try:
        return descriptions[type(event).__name__](event, _in_one_line(text), command)
    except (KeyError, AttributeError, TypeError, IndexError):
        return None


def _in_one_line(text: str) -> str:
    """Text of the parser in one line, without its frames."""
    lines = (line.strip("│╭╮╰╯─ ") for line in text.splitlines())
    return " ".join(line for line in lines if line)


# Each function below describes one kind of refusal in a line. event: tyro's refusal; text: what
# the parser printed, in one line; command: command that was typed.


def _describe_unknown(event: Any, text: str, command: str) -> str:
    """Error for options, or a subcommand, that the command does not have.

    event: tyro's refusal, with the words that it does not know; text: what tyro printed, with its
    suggestions; command: name of the command."""
    options = [token for token in event.tokens if token.startswith("-")]
    if not options:
        available = re.search(r"Available subcommands: (.+?)(?: For full|$)", text)
        if available is None:
            return f"unexpected argument {event.tokens[0]!r}: see {_help_line(command)}"
        remedy = describe_near(event.tokens[0], available[1].split(", "))
        if not remedy:
            remedy = f": choose among {available[1]}"
        return f"unknown command {command} {event.tokens[0]}{remedy}"
    name = options[0].partition("=")[0]
    meant = re.search(r"(?:Perhaps you meant|Similar arguments?)\W+(--[\w-]+)", text)
    remedy = f"did you mean {meant[1]}?" if meant else f"see {_help_line(command)}"
    return f"{command} has no option {name}: {remedy}"


def _describe_choice(event: Any, _: str, command: str) -> str:
    """Error for a value that is not among the choices of an option.

    event: tyro's refusal, with option, value and choices. The printed text is not needed."""
    choices = [choice for choice in event.choices if choice != "None"]
    if set(choices) <= set(LABELS):  # an option of classes, whose check has a better error
        try:
            check_classes([event.value])
        except ValueError as error:
            return f"{_option_name(event.argument)}: {error}"
    remedy = describe_near(event.value, choices)
    listed = ", ".join(choices)
    return f"{_option_name(event.argument)} must be one of {listed}, got {event.value!r}{remedy}"


def _describe_values(event: Any, text: str, command: str) -> str:
    """Error for words from which an option's value cannot be made.

    tyro's texts quote these words, as in: instantiated from ['1', 'two']."""
    if event.argument is None:
        return str(event.message)
    message = " ".join(str(event.message).split())
    match = re.search(r"instantiated from \[(.*?)\]", f"{message} {text}")
    quoted_words = re.findall(r"'([^']*)'", match[1] if match else str(event.message))
    typed_words = " ".join(quoted_words)
    received = f", got {typed_words}" if typed_words else ""
    rule = f"{_option_name(event.argument)} takes {_value_words(event.argument)}"
    return f"{rule}{received}{_help_sentence(event.argument)}"


def _describe_too_few(event: Any, _: str, command: str) -> str:
    """Error for an option with too few values, or with a value that it does not take."""
    if event.reason != "too_few_values":
        return f"{_option_name(event.argument)} takes no value, got {event.offending_value!r}"
    rule = f"{_option_name(event.argument)} needs {_value_words(event.argument)}"
    return f"{rule}{_help_sentence(event.argument)}"


def _describe_missing(event: Any, _: str, command: str) -> str:
    """Error for options and arguments that the command needs."""
    arguments = [missing.arg for missing in event.missing_arguments]
    needs = "; ".join(
        f"{_option_name(argument)}{_help_sentence(argument)}" for argument in arguments
    )
    return f"{command} needs {needs}"


def _describe_missing_command(event: Any, _: str, command: str) -> str:
    """Error for a command that needs a subcommand, such as coview site."""
    names = [name.split(":")[-1] for name in event.subcommand_spec.parser_from_name]
    text = f"{command} needs one of {', '.join(names)}"
    if event.found_token is None:
        return text
    return f"{text}, got {event.found_token!r}{describe_near(event.found_token, names)}"


def _help_line(command: str) -> str:
    """Command line that prints a command's help."""
    return "coview --help" if command == "coview" else f"coview {command} --help"


def _option_name(argument: Any) -> str:
    """Name of an argument as it is typed, without the name of its group."""
    return str(argument.display_name()).rpartition(".")[2]


def _help_sentence(argument: Any) -> str:
    """First sentence of an argument's help after a colon, "" without help."""
    helptext = argument.field.helptext
    text = helptext() if callable(helptext) else helptext
    # a sentence ends with a full stop or a semicolon
    sentence, *_ = re.split(r"\.(?:\s|$)|; ", (text or "").strip())
    line = " ".join(sentence.split())
    first_word = line.split(" ")[0]
    if first_word[1:].islower():  # but keep words such as AP
        line = f"{line[0].lower()}{line[1:]}"
    return f": {line}" if line else ""


def _value_words(argument: Any) -> str:
    """Words for the values that an option takes, such as "2 numbers".

    The parser writes them as the option's metavar: `{None}|{FLOAT FLOAT}` for two numbers or none,
    `[STR [STR ...]]` for several texts. Without words of `_KINDS`, and with several kinds or other
    words in capitals, the metavar itself is returned, without `{None}|` and outer braces."""
    metavar = str(argument.lowered.metavar).replace("{None}|", "")
    if metavar.startswith("{") and metavar.endswith("}") and "|" not in metavar:
        metavar = metavar[1:-1]
    words = metavar.replace("[", " ").replace("]", " ").split()
    # `_KINDS`: singular and plural of the values that a word such as FLOAT stands for
    kinds = [word for word in words if word in _KINDS]
    upper_words = [word for word in words if word.isupper()]
    if len(set(kinds)) != 1 or len(kinds) < len(upper_words):
        return metavar
    singular, plural = _KINDS[kinds[0]]
    if "..." in metavar or "*" in metavar:
        return f"one or several {plural}"
    return singular if len(kinds) == 1 else f"{len(kinds)} {plural}"
