"""Write the tables of the pages anew: ``python docs/generate``."""

from __future__ import annotations

from page_tables import PAGES, rewritten

for page in PAGES:
    old = page.read_text(encoding="utf-8")
    new = rewritten(old)
    if new != old:
        page.write_text(new, encoding="utf-8")
        print(f"{page.name} written")
