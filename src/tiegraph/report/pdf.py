"""report.pdf: the page printed by a headless browser, because nothing else lays it out as it is read."""

import os
import shutil
import subprocess
from pathlib import Path

from tiegraph.errors import EngineMissing, InputError
from tiegraph.scene.atomic import replacing, scratch_folder

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
_BEGIN = b"%PDF"


def find_browser() -> str:
    """Path of a browser that prints. Raises EngineMissing with the remedy if there is none."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found:
            return found
    raise EngineMissing(
        f"--pdf needs a browser of the Chromium family, and none of {', '.join(BROWSERS)} is on the PATH: install one, "
        "or open report.html in any browser and print it to a file there"
    )


def print_pdf(page: Path, target: Path) -> None:
    """Write ``target`` as the browser prints ``page``.

    Raises EngineMissing without a browser or if it prints nothing, InputError if ``target`` exists and is no PDF.
    """
    browser = find_browser()
    if target.exists() and (not target.is_file() or target.read_bytes()[:4] != _BEGIN):
        raise InputError(f"{target} exists and is no PDF: move it away, and run the same again")
    with scratch_folder() as scratch, replacing(target) as temporary:
        made = scratch / "report.pdf"
        command = [browser, "--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={scratch}/profile"]
        command.append("--no-pdf-header-footer")
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # Chromium refuses its sandbox to root
            command.append("--no-sandbox")
        command += [f"--print-to-pdf={made}", page.resolve().as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, timeout=120.0, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise EngineMissing(f"{browser} did not print {page.name} ({error}): {_REMEDY}") from None
        if not made.is_file() or made.read_bytes()[:4] != _BEGIN:
            raise EngineMissing(f"{browser} did not print {page.name} (exit code {done.returncode}): {_REMEDY}")
        shutil.copyfile(made, temporary)


_REMEDY = "open it in a browser and print it to a file there"
