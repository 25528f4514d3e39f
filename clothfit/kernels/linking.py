"""What becomes of the code of a kernel: machine code where Python calls it, else only what other code is linked with.

By default numba optimises each function as a whole, with all that it calls, and translates it to machine code. Most
kernels are only called by kernels, into whose code they are linked and with which they are optimised again, at every
level of calls anew. So of such a kernel only the code as numba writes it is kept, and all else is done once, for the
function that Python calls. That is a third of the time of a compilation.

A System has some thirty arrays. Wherever a kernel takes a part of one, numba counts references to all that this has, up
and down again. Most kernels need not (`Borrowed`), and without it there is less to write and to optimise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from llvmlite import binding
from numba.core import ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult, compile_result
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.environment import lookup_environment
from numba.core.typed_passes import NoPythonSupportedFeatureValidation, NopythonTypeInference

NAMED = (ir.Var, ir.Arg, ir.Const, ir.Global, ir.FreeVar)
PARTS = ("getattr", "static_getitem", "getitem", "build_tuple", "exhaust_iter", "getiter", "iternext", "pair_first",
         "pair_second", "cast", "phi")  # fmt: skip
"""Values and expressions that make no arrays, but name them, parts of them, or some together."""


class Linked(JITCodeLibrary):
    """Code that other code is linked with."""

    def _optimize_final_module(self) -> None:
        """Do nothing: the code that is linked with this is optimised as a whole."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """0: there is no machine code."""
        return 0

    @property
    def codegen(self) -> Any:
        """What `set_env` is called of."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Do nothing: the code that is linked with this knows its environment, see `Called`."""

    def serialize_using_object_code(self) -> Any:
        """The name, the kind and the code."""
        return self.serialize_using_bitcode()


class Called(JITCodeLibrary):
    """Code that Python calls, with that of all kernels that it calls."""

    def _optimize_final_module(self) -> None:
        """Simplify and inline a little in the first of numba's two rounds, which otherwise only inlines what it must.

        So references that cancel are seen to before the second round judges what is small enough to inline. Without
        that the large kernels keep some of them, to all arrays of a System: up to three times the duration.
        """
        before, self._codegen._opt_level = self._codegen._opt_level, 1
        try:
            super()._optimize_final_module()
        finally:
            self._codegen._opt_level = before

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            env = lookup_environment(variable.name)
            if env is not None:
                self.codegen.set_env(variable.name, env)


def rebuilt(context: Any, payload: tuple[Any, ...]) -> CompileResult:
    """What `CompileResult._reduce` took apart, of a kernel that other kernels call."""
    (name, _, code), described, env, signature, objectmode, lifted, annotation, reload_init, environments = payload
    for function in reload_init:
        function()
    library = Linked(context.codegen(), name)
    library._final_module = binding.parse_bitcode(code)
    library._finalize_final_module()
    made: CompileResult = compile_result(
        target_context=context,
        typing_context=context.typing_context,
        library=library,
        environment=env,
        entry_point=context.get_executable(library, described, env),
        fndesc=described,
        type_annotation=annotation,
        signature=signature,
        objectmode=objectmode,
        lifted=lifted,
        reload_init=reload_init,
        referenced_envs=environments,
    )
    return made


@register_pass(mutates_CFG=False, analysis_only=True)
class Borrowed(FunctionPass):
    """Count no references in a function that makes no arrays: all those that it has are parts of its arguments, which
    its caller keeps.
    """

    _name = "borrowed"

    def __init__(self) -> None:
        super().__init__()  # numba's is abstract

    def run_pass(self, state: Any) -> bool:
        """Choose the context in which the code is written."""
        if not any(_makes_arrays(state, kind, value) for kind, value in _computed(state)):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return False


def _computed(state: Any) -> Iterator[tuple[Any, Any]]:
    """The types of all that a function computes, with the expressions; none of what it returns, and of arrays that it
    writes into arrays, whose code makes words for shapes that differ.
    """
    yield state.return_type, None
    for block in state.func_ir.blocks.values():
        for line in block.body:
            if isinstance(line, ir.Assign):
                yield state.typemap[line.target.name], line.value
            elif isinstance(line, ir.SetItem | ir.StaticSetItem):
                yield state.typemap[line.value.name], None


def _makes_arrays(state: Any, kind: Any, value: Any) -> bool:
    """Whether a value may have arrays, or others whose references are counted, that no argument has."""
    if not _counts(state, kind) or isinstance(value, NAMED):
        return False
    if not isinstance(value, ir.Expr) or value.op not in PARTS:
        return True
    return value.op == "getitem" and _counts(state, state.typemap[value.index.name])  # an index array: a new array


def _counts(state: Any, kind: Any) -> bool:
    return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())


class _Pipeline(Compiler):
    kept: type[JITCodeLibrary]

    def define_pipelines(self) -> list[Any]:
        """numba's passes, with that of references before the code is written."""
        (passes,) = super().define_pipelines()
        if self.state.flags.force_pyobject:
            return [passes]
        passes.add_pass_after(Borrowed, NoPythonSupportedFeatureValidation)
        passes.finalize()
        return [passes]

    def compile_extra(self, function: Callable[..., object]) -> Any:
        """Compile a function."""
        self._make_library(function.__qualname__)
        return super().compile_extra(function)

    def compile_ir(self, func_ir: Any, lifted: Any = (), lifted_from: Any = None) -> Any:
        """Compile a function of which parts run in the interpreter, or such a part."""
        if not self.state.flags.force_pyobject:
            self._make_library(func_ir.func_id.func_qualname)
        return super().compile_ir(func_ir, lifted, lifted_from)

    def _make_library(self, name: str) -> None:
        self.state.library = self.kept(self.state.targetctx.codegen(), name)
        self.state.library.enable_object_caching()


class ForKernels(_Pipeline):
    """numba's pipeline for a function that kernels call."""

    kept = Linked


class ForPython(_Pipeline):
    """numba's pipeline for a function that Python calls."""

    kept = Called


class AllKnown(Exception):
    """All that was wanted is known."""


@register_pass(mutates_CFG=False, analysis_only=True)
class Stop(FunctionPass):
    """Stop."""

    _name = "stop"

    def __init__(self) -> None:
        super().__init__()  # numba's is abstract

    def run_pass(self, state: Any) -> bool:
        """Raise Enough."""
        raise AllKnown


class Inferred(_Pipeline):
    """numba's pipeline for a function that Python calls, as far as its types."""

    kept = Called

    def define_pipelines(self) -> list[Any]:
        """numba's passes up to the one that infers types."""
        (passes,) = super().define_pipelines()
        passes.add_pass_after(Stop, NopythonTypeInference)
        passes.finalize()
        return [passes]
