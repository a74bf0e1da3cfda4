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
SHAPED = (  # scripts whose letters are joined or reordered, as Unicode names them
    *(
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
    ),
    *("TELUGU", "KANNADA", "MALAYALAM", "SINHALA", "KHMER", "MYANMAR", "TIBETAN", "MONGOLIAN"),
)


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
    missing = frozenset(letter for letter in letters if ord(letter) not in list_letters(base))
    if not shaping:
        misordered = frozenset(letter for letter in letters if _needs_shaping(letter))
        choice = _choose(missing - misordered)
        return choice._replace(unset=choice.unset | misordered)
    return _choose(missing)


def name_letters(letters: Iterable[str]) -> str:
    """List letters by their code points, such as "U+4EA4, U+901A", which any font can set."""
    return ", ".join(f"U+{ord(letter):04X}" for letter in sorted(letters))


@cache
def list_letters(font: Path) -> frozenset[int]:
    """Code points that a font can draw, by its file.

    Empty for a file that is not an outline font, and for a font that draws boxes."""
    from matplotlib.ft2font import FT2Font

    try:
        face = FT2Font(str(font))
        letters = frozenset(face.get_charmap())
    except (RuntimeError, OSError, ValueError, UnicodeError):
        return frozenset()
    is_outline = bool(face.scalable)
    is_box = any(word in f"{face.family_name} {font.name}".lower() for word in PLACEHOLDERS)
    return letters if is_outline and not is_box else frozenset()


def list_system_fonts() -> tuple[Path, ...]:
    """Files of the fonts that this computer has, sorted."""
    from matplotlib import font_manager

    return tuple(sorted(map(Path, font_manager.findSystemFonts())))


def family_name(font: Path) -> str:
    """Name of the family of a font, by its file; the first font of a collection counts."""
    from matplotlib.ft2font import FT2Font

    return str(FT2Font(str(font)).family_name)


@cache
def _choose(missing: frozenset[str]) -> FontChoice:
    # Fonts for missing letters: DejaVu Sans and, if it lacks some, fonts of the computer. Again and
    # again, the font with the most letters that are still unset is taken.
    unset = {ord(letter) for letter in missing}
    files: list[Path] = []
    house_fonts = [own_font("DejaVuSans")] if unset else []
    candidates = [
        *house_fonts,
        *(
            list_system_fonts()
            if unset - list_letters(house_fonts[0] if house_fonts else Path())
            else ()
        ),
    ]
    while unset:
        best = max(candidates, key=_rank(unset), default=None)
        if best is None or not unset & list_letters(best):
            break
        files.append(best)
        unset -= list_letters(best)
    families = tuple(dict.fromkeys(map(family_name, files)))
    return FontChoice(tuple(files), families, frozenset(map(chr, unset)))


def _rank(unset: set[int]) -> Callable[[Path], tuple[int, int, int, str]]:
    """Return the key by which fonts are compared; the best font has the greatest key.

    unset: code points that no chosen font has. The key compares the number of these letters that a
    font has, then the preference of its family, then regular before other styles, then names."""

    def rank(font: Path) -> tuple[int, int, int, str]:
        shared = len(unset & list_letters(font))
        if not shared:
            return 0, 0, 0, ""
        name = family_name(font).lower()
        preference = next(
            (-k for k, word in enumerate(PREFERRED) if name.startswith(word)), -len(PREFERRED)
        )
        styled = any(
            word in font.stem.lower()
            for word in ("bold", "italic", "oblique", "light", "thin", "black")
        )
        return shared, preference, -int(styled), font.name

    return rank


def _is_drawn(letter: str) -> bool:
    """Return False for spaces, control characters, and selectors that only change other letters."""
    # U+FE00 and U+E0100 begin the blocks of variation selectors
    is_selector = "\ufe00" <= letter <= "\ufe0f" or "\U000e0100" <= letter <= "\U000e01ef"
    return not (
        letter.isspace() or is_selector or unicodedata.category(letter) in ("Cc", "Cf", "Cs")
    )


def _needs_shaping(letter: str) -> bool:
    # True if letters of the script are joined or reordered when they are set.
    return unicodedata.name(letter, "").startswith(SHAPED)


def replace_letters(text: str, letters: frozenset[str]) -> str:
    """Replace letters of a text by `UNSET`, one for each run of them."""
    letters_shown: list[str] = []
    for letter in text:
        if letter not in letters:
            letters_shown.append(letter)
        elif not letters_shown or letters_shown[-1] != UNSET:
            letters_shown.append(UNSET)
    return "".join(letters_shown)


def number_names(names: Sequence[str], unset: frozenset[str], noun: str) -> dict[str, str]:
    """Replacements, such as "pole 3", of names with letters that cannot be set, by name.

    unset: these letters; noun: word before the number, which is the name's place among all names,
    from 1. A replacement that is in use is not taken again."""
    numbers: dict[str, str] = {}
    names_in_use = set(names)
    for k, name in enumerate(names, start=1):
        if not unset & set(name):
            continue
        while f"{noun} {k}" in names_in_use:
            k += len(names)  # beyond the numbers of all other names
        numbers[name] = f"{noun} {k}"
        names_in_use.add(numbers[name])
    return numbers


def spell_name(name: str, unset: frozenset[str]) -> str:
    """Replace letters of a name by their code points, such as "U+1F6A6 Ampel".

    unset: letters that no font can set."""
    spelled = "".join(f" U+{ord(letter):04X} " if letter in unset else letter for letter in name)
    return " ".join(spelled.split())
