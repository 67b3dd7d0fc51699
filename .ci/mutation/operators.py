"""Mistakes of refactoring that Cosmic Ray does not make: no argument, no guard."""

import parso
from cosmic_ray.operators.operator import Example, Operator


def _is_named(node):
    """Whether a node is an argument by name."""
    return node.type == "argument" and node.children[1] == "="


class DropArgument(Operator):
    """Leave out an argument that is given by name."""

    def mutation_positions(self, node):
        """Of each such argument."""
        for child in self._named(node):
            yield child.start_pos, child.end_pos

    def mutate(self, node, index):
        """The call without its argument `index`."""
        place = node.children.index(self._named(node)[index])
        # With the comma after it, or the one before the last.
        end = (
            place + 2
            if place + 1 < len(node.children) and node.children[place + 1] == ","
            else place + 1
        )
        del node.children[place - (end == place + 1 and node.type == "arglist" and place > 0) : end]
        return node

    @staticmethod
    def _named(node):
        of_calls = node.type == "arglist" or (node.type == "trailer" and node.children[0] == "(")
        return [child for child in node.children if _is_named(child)] if of_calls else []

    @classmethod
    def examples(cls):
        """Before and after."""
        return (
            Example("f(a, b=1)", "f(a)"),
            Example("f(a=1, b=2)", "f( b=2)"),
            Example("f(a=1)", "f()"),
        )


class DropGuard(Operator):
    """Never raise what an `if` raises."""

    def mutation_positions(self, node):
        """Of the condition."""
        if node.type == "if_stmt" and node.children[3].get_code().strip().startswith("raise"):
            yield node.children[1].start_pos, node.children[1].end_pos

    def mutate(self, node, index):
        """The guard with a condition that never holds."""
        node.children[1] = parso.parse(" False")
        return node

    @classmethod
    def examples(cls):
        """Before and after."""
        return (Example("if a:\n    raise b", "if False:\n    raise b"),)


class Provider:
    """Both by their names."""

    def __iter__(self):
        return iter(("DropArgument", "DropGuard"))

    def __getitem__(self, name):
        return {"DropArgument": DropArgument, "DropGuard": DropGuard}[name]
