"""Moves of sliders, for the tests of what the explorer remembers."""

from cddf_jax.explorer.past import after_move, loop_of

FIRST, SECOND, FORCE, MODULUS = "base_tension_1", "base_tension_2", "tip_force.1", "youngs_modulus"
FORGET = "the button"


def turns_of(explored, *moves):
    """After the first picture, and moves that are numbers by name or the button that forgets."""
    turns, settings = (), explored.start
    for move in ({}, *moves):
        numbers = {} if move == FORGET else move
        settings = settings._replace(numbers={**settings.numbers, **numbers})
        turns = after_move(() if move == FORGET else turns, explored, settings)
    return turns


def loop_after(explored, *moves):
    """The loop, with the manipulator as it is set then."""
    numbers = {name: number for move in moves for name, number in move.items()}
    body = explored.case(explored.start._replace(numbers={**explored.start.numbers, **numbers})).manipulator
    return body, loop_of(body, turns_of(explored, *moves), explored.arc_length)
