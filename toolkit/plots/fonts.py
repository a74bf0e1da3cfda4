"""Fonts of this computer, for letters that the house's font lacks.

Pictures are set in DejaVu Sans, which comes with matplotlib and has Latin, Greek, Cyrillic, Hebrew,
Arabic, Georgian and Armenian letters. For others a font of the system is looked for;
letters without any font are named, and whoever sets a name writes something else in its place,
never an empty box."""

import unicodedata
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

# parts of the names of fonts that draw a box in place of every letter
PLACEHOLDERS = ("lastresort", "last resort", "adobeblank", "adobe blank", "notdef", "keyboard")
# beginnings of the names of families, best first
PREFERRED = (
    "noto sans",
    "dejavu sans",
    "noto",
    "arial unicode",
    "source han sans",
    "droid sans fallback",
)
UNSET = "?"  # in place of a letter that no font has
SHAPED_SCRIPTS = (  # scripts whose letters are joined or reordered, as Unicode names them
    "ARABIC",
    "HEBREW",
    "SYRIAC",
    "THAANA",
    "NKO",
    "DEVANAGARI",
    "BENGALI",
    "GURMUKHI",
    "GUJARATI",
    "ORIYA",
    "TAMIL",
    "TELUGU",
    "KANNADA",
    "MALAYALAM",
    "SINHALA",
    "KHMER",
    "MYANMAR",
    "TIBETAN",
    "MONGOLIAN",
)
# words in the names of fonts whose style is not regular
STYLE_WORDS = ("bold", "italic", "oblique", "light", "thin", "black")


class FontChoice(NamedTuple):
    """Fonts for some letters.

    Attributes:
        files: files of the fonts, in the order of use.
        families: names of the fonts' families, each once.
        unset: letters that no font can set.
    """

    files: tuple[Path, ...]
    families: tuple[str, ...]
    unset: frozenset[str]


def own_font(name: str) -> Path:
    """File of a font that comes with matplotlib, by its name such as DejaVuSans."""
    import matplotlib

    return Path(matplotlib.get_data_path(), "fonts", "ttf", f"{name}.ttf")


def choose_fonts(texts: Iterable[str], base: Path, *, shaping: bool = True) -> FontChoice:
    """Choose fonts for the letters of texts that a font lacks, as few as possible.

    base: file of the font in which the texts are set; shaping: True if the program that sets the
    texts joins and orders letters as their script requires; otherwise letters of scripts that need
    it count as unset."""
    letters = {letter for text in texts for letter in text if _is_drawn(letter)}
    base_letters = list_letters(base)
    missing_letters = frozenset(letter for letter in letters if ord(letter) not in base_letters)
    if not shaping:
        misordered_letters = frozenset(letter for letter in letters if _needs_shaping(letter))
        choice = cover_letters(missing_letters - misordered_letters)
        return choice._replace(unset=choice.unset | misordered_letters)
    return cover_letters(missing_letters)


def name_letters(letters: Iterable[str]) -> str:
    """List letters by their code points, such as "U+4EA4, U+901A", which any font can set."""
    return ", ".join(f"U+{ord(letter):04X}" for letter in sorted(letters))


@cache
def list_letters(font: Path) -> frozenset[int]:
    """Code points that a font can draw, by its file.

    Empty for a file that is not an outline font, and for a font that draws a box in place of every
    letter."""
    from matplotlib.ft2font import FT2Font

    try:
        face = FT2Font(str(font))
        letters = frozenset(face.get_charmap())
    except (RuntimeError, OSError, ValueError, UnicodeError):
        return frozenset()
    is_outline = bool(face.scalable)
    names = f"{face.family_name} {font.name}".lower()
    draws_boxes = any(word in names for word in PLACEHOLDERS)
    return letters if is_outline and not draws_boxes else frozenset()


def list_system_fonts() -> tuple[Path, ...]:
    """Files of the fonts that this computer has, sorted."""
    from matplotlib import font_manager

    return tuple(sorted(map(Path, font_manager.findSystemFonts())))


def family_name(font: Path) -> str:
    """Name of the family of a font, by its file; the first font of a collection counts."""
    from matplotlib.ft2font import FT2Font

    return str(FT2Font(str(font)).family_name)


@cache
def cover_letters(missing: frozenset[str]) -> FontChoice:
    """Choose fonts for missing letters from DejaVu Sans and, if it lacks some, the computer's.

    Again and again, the font with the most letters that are still unset is taken."""
    unset_codes = {ord(letter) for letter in missing}
    files: list[Path] = []
    candidates: list[Path] = []
    if unset_codes:
        house_font = own_font("DejaVuSans")
        candidates.append(house_font)
        if unset_codes - list_letters(house_font):
            candidates += list_system_fonts()
    while unset_codes:
        best = max(candidates, key=_make_rank(unset_codes), default=None)
        if best is None or not unset_codes & list_letters(best):
            break
        files.append(best)
        unset_codes -= list_letters(best)
    families = tuple(dict.fromkeys(map(family_name, files)))
    return FontChoice(tuple(files), families, frozenset(map(chr, unset_codes)))


def _make_rank(unset: set[int]) -> Callable[[Path], tuple[int, int, int, str]]:
    """Return the key by which fonts are compared; the best font has the greatest key.

    unset: code points that no chosen font has."""

    def rank(font: Path) -> tuple[int, int, int, str]:
        """Sort key of a font, greatest for the best, by its file.

        It compares the number of letters of `unset` that the font has, then the preference of its
        family, then regular before other styles, then names of files."""
        letter_count = len(unset & list_letters(font))
        if not letter_count:
            return 0, 0, 0, ""
        family = family_name(font).lower()
        preference = -len(PREFERRED)  # 0 for the best family, then -1 and so on
        for k, beginning in enumerate(PREFERRED):
            if family.startswith(beginning):
                preference = -k
                break
        is_styled = any(word in font.stem.lower() for word in STYLE_WORDS)
        return letter_count, preference, -int(is_styled), font.name

    return rank


def _is_drawn(letter: str) -> bool:
    """Return False for spaces, control characters, and selectors that only change other letters."""
    # U+FE00 and U+E0100 begin the blocks of variation selectors
    is_selector = "\ufe00" <= letter <= "\ufe0f" or "\U000e0100" <= letter <= "\U000e01ef"
    # control characters, format characters and surrogates
    is_control = unicodedata.category(letter) in ("Cc", "Cf", "Cs")
    return not (letter.isspace() or is_selector or is_control)


def _needs_shaping(letter: str) -> bool:
    # True if letters of the script are joined or reordered when they are set.
    return unicodedata.name(letter, "").startswith(SHAPED_SCRIPTS)


def replace_letters(text: str, letters: frozenset[str]) -> str:
    """Replace letters of a text by `UNSET`, one for each run.

    letters: letters that no font can set."""
    new_letters: list[str] = []
    for letter in text:
        if letter not in letters:
            new_letters.append(letter)
        elif not new_letters or new_letters[-1] != UNSET:
            new_letters.append(UNSET)
    return "".join(new_letters)


def number_names(names: Sequence[str], unset: frozenset[str], noun: str) -> dict[str, str]:
    """Replacements, such as "pole 3", by name, of names with letters that no font has.

    unset: these letters; noun: word before the number, which is the name's place among all names,
    from 1. A replacement that is in use is not taken again."""
    replacements: dict[str, str] = {}
    names_in_use = set(names)
    for place, name in enumerate(names, start=1):
        if not unset & set(name):
            continue
        number = place
        while f"{noun} {number}" in names_in_use:
            number += len(names)  # beyond the numbers of all other names
        replacements[name] = f"{noun} {number}"
        names_in_use.add(replacements[name])
    return replacements


def spell_name(name: str, unset: frozenset[str]) -> str:
    """Replace letters of a name by their code points, such as "U+1F6A6 Ampel".

    unset: letters that no font can set."""
    spelled = "".join(f" U+{ord(letter):04X} " if letter in unset else letter for letter in name)
    return " ".join(spelled.split())
