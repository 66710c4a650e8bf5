"""Moves of sliders, for the tests of what the explorer remembers."""

from cddf_jax.explorer.past import PastMoves, after_move

FIRST, SECOND, FORCE, GRAVITY, MODULUS = (
    "base_tension_1",
    "base_tension_2",
    "tip_force.1",
    "gravity.1",
    "youngs_modulus",
)
FORGET = "the button"


def past_of(explored, *moves):
    """After the first picture, and moves that are numbers by name or the button that forgets."""
    past, settings = PastMoves(), explored.start
    for move in ({}, *moves):
        numbers = {} if move == FORGET else move
        past = PastMoves() if move == FORGET else past
        settings = settings._replace(numbers={**settings.numbers, **numbers})
        past = after_move(past, explored, settings)
    return past


def body_of(explored, *moves):
    """The manipulator as it is set then."""
    numbers = {name: number for move in moves if move != FORGET for name, number in move.items()}
    return explored.case(explored.start._replace(numbers={**explored.start.numbers, **numbers})).manipulator
