"""`kept_program`: a compiled function whose programs the next process finds on the disk.

With traced values, under a user's jit, vmap or grad, it is the plain compiled function. So it is if a function or a
class of the user takes part. If keeping is switched off, every process makes its programs again.
"""

import hashlib
import itertools
import json
import logging
from collections.abc import Callable, Hashable, Sequence
from functools import cache, wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import Mesh

from ..progress import stage
from . import folder
from .environment import are_special, is_source_unchanged, machine_and_versions, named_settings, settings
from .executables import Interface, Program, Signature, UnavailableError, compiled, is_within_reach, loaded, spec_of
from .json_form import NotDescribedError, Place, describe, rebuild

MOST = 512  # programs in memory
LOG = logging.getLogger("cddf_jax.programs")
Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


class Call(NamedTuple):
    """A program, and the structure of its answer."""

    program: Program
    inputs: tuple[int, ...]  # the arrays among the leaves of the arguments
    structure: Any  # of `jax.tree.structure`
    leaves: tuple[Any, ...]  # of the answer: the number of an output as a `Place`, or a value

    def __call__(self, arguments: Sequence[Any]) -> Any:
        outputs = self.program([arguments[i] for i in self.inputs])
        return self.structure.unflatten([outputs[x.of] if isinstance(x, Place) else x for x in self.leaves])


class Question(NamedTuple):
    """A call to be answered: a function and its arguments, flat."""

    function: Callable[..., Any]  # compiled by JAX
    structure: Any  # of (args, kwargs), of `jax.tree.structure`
    leaves: tuple[Any, ...]  # a `Signature` in place of every array

    @property
    def places(self) -> tuple[int, ...]:
        """Where the arrays are among the leaves."""
        return tuple(i for i, leaf in enumerate(self.leaves) if isinstance(leaf, Signature))

    @property
    def inputs(self) -> tuple[Signature, ...]:
        return tuple(leaf for leaf in self.leaves if isinstance(leaf, Signature))

    @property
    def mesh(self) -> Mesh | None:
        """The mesh among the arguments, if there are several devices."""
        return next((leaf for leaf in self.leaves if isinstance(leaf, Mesh)), None)


PROGRAMS: dict[Hashable, Call | None] = {}  # None: left to JAX
UNKNOWN: Any = object()  # a call that was not asked before
LEFT_TO_JAX: Any = object()  # the kind of a leaf with which no program is kept
ON_HOST = np.ndarray, np.generic


def kept_program(function: Callable[Arguments, Answer]) -> Callable[Arguments, Answer]:
    """Keep the programs of a function that `jax.jit` or `eqx.filter_jit` compiles.

    Only for the library's outermost functions: a kept program cannot be differentiated or vmapped. Numbers and texts
    among the arguments are static, arrays are traced.
    """

    @wraps(function)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Answer:
        leaves, structure = jax.tree.flatten((args, kwargs))
        kinds = [_kind_of(leaf) for leaf in leaves]
        if LEFT_TO_JAX in kinds or not jax.sharding.get_abstract_mesh().empty:
            return function(*args, **kwargs)
        at = (call, structure, *kinds, settings())
        try:
            known = PROGRAMS.get(at, UNKNOWN)
            if known is UNKNOWN:
                if not _can_be_kept(leaves, (*args, *kwargs.values())):
                    return function(*args, **kwargs)
                question = Question(function, structure, tuple(map(_signature, leaves)))
                known = _remember(at, _answer_to(question, [leaf for leaf in leaves if eqx.is_array(leaf)]))
            if known is not None:
                return known(leaves)
        except UnavailableError as error:
            LOG.debug("%s is left to JAX: %s", function.__qualname__, error)
            _remember(at, None)
        return function(*args, **kwargs)

    return call


def shapes_of(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of `jax.eval_shape` for a callable pytree, kept like a program, because it needs a trace."""
    leaves, structure = jax.tree.flatten((function, *arguments))
    question = Question(jax.eval_shape, structure, tuple(map(_signature, leaves)))
    try:
        if folder.is_off() or not _can_be_kept(leaves, arguments) or are_special() or not is_source_unchanged():
            raise UnavailableError("switched off, special values or settings of JAX, or a source that was edited")
        key = _key(question)
    except (NotDescribedError, UnavailableError) as error:
        LOG.debug("shapes are traced: %s", error)
        return jax.eval_shape(function, *arguments)
    entry = folder.read(key)
    if entry is None:
        found = jax.eval_shape(function, *arguments)
        described = describe(jax.tree.map(lambda x: Place([x.shape, x.dtype.name]), found))
        folder.write(key, folder.Entry({"answer": described}, b""))
        return found
    places, answer = jax.tree.flatten(rebuild(entry.about["answer"]), is_leaf=lambda x: isinstance(x, Place))
    return answer.unflatten([jax.ShapeDtypeStruct(tuple(place.of[0]), place.of[1]) for place in places])


def _kind_of(leaf: Any) -> Any:
    """What the choice of a program depends on: the type with a value (because 1 equals True) or a shape."""
    kind = type(leaf)
    if isinstance(leaf, ON_HOST):
        return kind, leaf.shape, leaf.dtype
    if isinstance(leaf, jax.Array):
        known = not isinstance(leaf, Tracer) and isinstance(leaf.dtype, np.dtype)  # no key of random numbers
        return (kind, leaf.shape, leaf.dtype, leaf.weak_type, leaf.sharding) if known else LEFT_TO_JAX
    return LEFT_TO_JAX if kind.__hash__ is None else (kind, leaf)


def _can_be_kept(leaves: Sequence[Any], arguments: tuple[Any, ...]) -> bool:
    """Whether all arguments have concrete values within reach, and can be part of a key."""
    if not jax.sharding.get_abstract_mesh().empty or not all(map(_is_known, leaves)):
        return False
    numbers = sum(type(leaf) is float for leaf in leaves)  # in a tree, each value of one would make a program
    return numbers == sum(type(argument) is float for argument in arguments)


def _is_known(leaf: Any) -> bool:
    if isinstance(leaf, jax.Array) and (isinstance(leaf, Tracer) or not is_within_reach(leaf.sharding)):
        return False
    if eqx.is_array(leaf):
        return isinstance(leaf.dtype, np.dtype) and leaf.dtype.kind in "biufc"
    return type(leaf).__hash__ is not None


def _signature(leaf: Any) -> Any:
    if not eqx.is_array(leaf):
        return leaf
    double: bool = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    dtype, weak, spec = _name_of(leaf.dtype, double), False, None
    if isinstance(leaf, jax.Array):
        weak, spec = leaf.weak_type, spec_of(leaf.sharding)
    return Signature(leaf.shape, dtype, weak, spec)


@cache
def _name_of(dtype: np.dtype, double: bool) -> str:
    """The name of a type in JAX at this precision; it is cached, because NumPy is slow at it."""
    return jax.dtypes.canonicalize_dtype(dtype).name


def _remember(at: Hashable, call: Call | None) -> Call | None:
    while len(PROGRAMS) >= MOST:
        PROGRAMS.pop(next(iter(PROGRAMS)), None)
    PROGRAMS[at] = call
    return call


def _answer_to(question: Question, arrays: Sequence[Any]) -> Call:
    """The program from the disk, or else a new one; `UnavailableError` if it cannot be kept."""
    if are_special() or not is_source_unchanged():
        raise UnavailableError("special settings of JAX, or a source that was edited")
    if question.mesh is None and any(one.spec for one in question.inputs):
        raise UnavailableError("arrays that several devices share")
    if folder.is_off():
        return _made("", question, arrays)
    try:
        key = _key(question)
    except NotDescribedError as error:
        raise UnavailableError(f"it involves {error}") from None
    return _found(key, question) or _made(key, question, arrays)


def _key(question: Question) -> str:
    """A digest of all that the program depends on; `NotDescribedError` if something of the user takes part."""
    leaves = [Place(leaf) if isinstance(leaf, Signature) else leaf for leaf in question.leaves]
    function = f"{question.function.__module__}:{question.function.__qualname__}"
    parts = [function, describe(question.structure.unflatten(leaves)), machine_and_versions(), named_settings()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _found(key: str, question: Question) -> Call | None:
    """The program on the disk, if it is there and complete."""
    entry = folder.read(key)
    if entry is None:
        return None
    try:
        outputs = tuple(Signature.read(*one) for one in entry.about["outputs"])
        interface = Interface(question.inputs, outputs, question.mesh, entry.about["lapack"])
        leaves, structure = jax.tree.flatten(rebuild(entry.about["answer"]), is_leaf=lambda x: isinstance(x, Place))
        return Call(loaded(entry.content, interface), question.places, structure, tuple(leaves))
    except (UnavailableError, NotDescribedError, AttributeError, ImportError, KeyError, TypeError) as error:
        LOG.debug("%s is made again: %s", key, error)
        return None


@stage("compiling")
def _made(key: str, question: Question, arrays: Sequence[Any]) -> Call:
    """Trace and compile a program, and keep it."""
    answers: list[Any] = []

    def flat(*traced: jax.Array) -> list[jax.Array]:
        values = iter(traced)
        leaves = [next(values) if isinstance(leaf, Signature) else leaf for leaf in question.leaves]
        args, kwargs = question.structure.unflatten(leaves)
        found, structure = jax.tree.flatten(question.function(*args, **kwargs))
        count = itertools.count()
        answers[:] = structure, tuple(Place(next(count)) if eqx.is_array(x) else x for x in found)
        return [jnp.asarray(x, x.dtype).astype(x.dtype) for x in found if eqx.is_array(x)]  # none typed weakly

    program = compiled(flat, arrays, question.inputs, question.mesh)
    call = Call(program, question.places, *answers)
    _keep(key, call)
    return call


def _keep(key: str, call: Call) -> None:
    """Write a program that has not run yet: after a run it may not be possible to turn it into bytes."""
    if folder.is_off() or not is_source_unchanged():  # while it was traced
        return
    try:
        answer, interface = describe(call.structure.unflatten(call.leaves)), call.program.interface
        about = {"outputs": interface.outputs, "lapack": interface.lapack, "answer": answer}
        folder.write(key, folder.Entry(about, call.program.as_bytes()))
    except (NotDescribedError, UnavailableError) as error:
        LOG.debug("%s is not kept: %s", key, error)
