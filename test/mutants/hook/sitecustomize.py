"""Puts a mutant into each Python process: LAB_MUTANT is its module, file, node and choice."""

import importlib.abc
import importlib.machinery
import importlib.util
import os
import sys

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


class MutantLoader(importlib.machinery.SourceFileLoader):
    """Compiles the mutated syntax tree, and neither reads nor writes compiled files."""

    def __init__(self, name, path, node, choice):
        super().__init__(name, path)
        self._site = (node, choice)

    def get_code(self, fullname):
        from mutations import mutated

        tree = mutated(self.get_data(self.path), *self._site)
        return compile(tree, self.path, "exec", dont_inherit=True)


class MutantFinder(importlib.abc.MetaPathFinder):
    def __init__(self, module, path, node, choice):
        self._module = module
        self._loader = MutantLoader(module, path, int(node), int(choice))
        self._path = path

    def find_spec(self, fullname, path=None, target=None):
        if fullname != self._module:
            return None
        return importlib.util.spec_from_file_location(fullname, self._path, loader=self._loader)


if "LAB_MUTANT" in os.environ:
    sys.meta_path.insert(0, MutantFinder(*os.environ["LAB_MUTANT"].split(";")))
