"""What README.md shows of the Python package runs as it stands there."""

import contextlib
import io
import os
import unittest

from common import SOURCE, InFolder


class Readme(InFolder):
    def test_what_it_shows_runs(self):
        lines = (SOURCE / "README.md").read_text(encoding="utf-8").splitlines()
        begin = lines.index("    import taut")
        shown = []
        for line in lines[begin:]:
            if line and not line.startswith("    "):
                break
            shown.append(line[4:])
        self.assertGreater(len(shown), 8)
        for name in ("experiments", "data"):
            os.symlink(SOURCE / name, name)
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile("\n".join(shown), "README.md", "exec"), {})
        for part in ("E_foam", "well determined", "tip_load", "reading_lower95", "reached"):
            self.assertIn(part, printed.getvalue())


if __name__ == "__main__":
    unittest.main()
