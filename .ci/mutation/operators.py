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
        following = node.children[place + 1 : place + 2]
        if following == [","] or node.type == "trailer":
            del node.children[place : place + 1 + (following == [","])]
        else:  # The last one goes with the comma before it.
            del node.children[place - 1 : place + 1]
        return node

    @staticmethod
    def _named(node):
        of_calls = node.type == "arglist" or (
            node.type == "trailer" and node.children[0] == "("
        )
        return (
            [child for child in node.children if _is_named(child)] if of_calls else []
        )

    @classmethod
    def examples(cls):
        """Before and after."""
        return (
            Example("f(a, b=1)", "f(a)"),
            Example("f(a=1, b=2)", "f( b=2)"),
            Example("f(a=1)", "f()"),
            Example("f(a=1, b=2)", "f(a=1)", occurrence=1),
        )


class DropGuard(Operator):
    """Never raise what an `if` raises."""

    def mutation_positions(self, node):
        """Of the condition."""
        if node.type == "if_stmt" and node.children[3].get_code().strip().startswith(
            "raise"
        ):
            yield node.children[1].start_pos, node.children[1].end_pos

    def mutate(self, node, index):
        """The guard with a condition that never holds."""
        node.children[1] = parso.parse(" False")
        return node

    @classmethod
    def examples(cls):
        """Before and after."""
        return (Example("if a:\n    raise b", "if False:\n    raise b"),)


OPERATORS = {operator.__name__: operator for operator in (DropArgument, DropGuard)}


class Provider:
    """Both by their names."""

    def __iter__(self):
        return iter(OPERATORS)

    def __getitem__(self, name):
        return OPERATORS[name]


if __name__ == "__main__":  # The examples hold.
    from cosmic_ray.mutating import mutate_code  # It loads this module.

    for operator in OPERATORS.values():
        for example in operator.examples():
            mutated = mutate_code(
                example.pre_mutation_code, operator(), example.occurrence
            )
            assert mutated == example.post_mutation_code, (mutated, example)
