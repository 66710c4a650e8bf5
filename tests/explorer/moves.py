"""Moves of sliders, for the tests of what the explorer remembers."""

from cddf_jax.explorer.past import after_move, loop_of

FIRST, SECOND, FORCE, MODULUS = "base_tension_1", "base_tension_2", "tip_force.1", "youngs_modulus"
FORGET = "the button"


def moves_of(explored, *moves):
    """After the first picture, and moves that are numbers by name or the button that forgets."""
    found, settings = (), explored.start
    for move in ({}, *moves):
        numbers = {} if move == FORGET else move
        settings = settings._replace(numbers={**settings.numbers, **numbers})
        found = after_move(() if move == FORGET else found, explored, settings)
    return found


def loop_after(explored, *moves, tendon=0):
    """The path of a tendon, with the manipulator as it is set then."""
    numbers = {name: number for move in moves for name, number in move.items()}
    body = explored.case(explored.start._replace(numbers={**explored.start.numbers, **numbers})).manipulator
    return body, loop_of(body, moves_of(explored, *moves), tendon, explored.arc_length)
