"""What README.md and docs/*.md name exists: links, files, commands and their options."""

import re
import unittest

from support import SOURCE, run

PAGES = [SOURCE / "README.md", *sorted((SOURCE / "docs").glob("*.md"))]


class DocsTest(unittest.TestCase):
    def test_links_and_named_files_exist(self):
        for page in PAGES:
            text = page.read_text()
            for link in re.findall(r"\]\(([^)#\s]+)", text):
                if "://" not in link:
                    self.assertTrue((page.parent / link).exists(), f"{page.name}: {link}")
            for path in re.findall(r"(?<![\w/.-])(data/[\w/.-]+\.(?:toml|py|ply|obj|csv|png))", text):
                self.assertTrue((SOURCE / path).exists(), f"{page.name}: {path}")

    def test_commands_and_options_exist(self):
        commands = set(re.findall(r"^  ([a-z]+)  ", run("--help").out.decode(), re.M))
        known = {c: set(re.findall(r"--[a-z][a-z0-9-]*|(?<=[ ,])-[a-z]\b", run(c, "--help").out.decode())) for c in commands}
        for page in PAGES:
            for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.S):
                for line in block.replace("\\\n", " ").splitlines():
                    for call in re.findall(r"(?:^|[|&] *)(?:build/)?sekitei ([^|&#]*)", line):
                        words = call.split()
                        if words and words[0].isalpha() and words[0].islower():
                            self.assertIn(words[0], commands, f"{page.name}: {line}")
                            for word in words[1:]:
                                if re.match(r"--?[a-z]", word):
                                    self.assertIn(word.split("=")[0], known[words[0]], f"{page.name}: {line}")


if __name__ == "__main__":
    unittest.main()
