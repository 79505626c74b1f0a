"""Declaration of a node's ROS parameters from the names, defaults and ranges of a `Config`.

The node must be created with `automatically_declare_parameters_from_overrides=True`, or misspelled
names are not found. An empty list has no type in ROS, so that its parameter has the value `['']`.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from hoid_common.config import EXPERT, Config, Param, did_you_mean
from hoid_common.errors import ConfigError

C = TypeVar('C', bound=Config)

_INT64_MAX = 2**63 - 1
_ROS_PREFIXES = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


class AcceptsEmptyLists(Node):
    """Base class of nodes that accept empty lists as parameters, for which rclpy raises."""

    def declare_parameters(
        self, namespace: str, parameters: Any, ignore_override: bool = False
    ) -> list[Parameter]:
        typed = [
            (name, _to_ros(()) if value is None else value, *rest)
            for name, value, *rest in parameters
        ]
        declared: list[Parameter] = super().declare_parameters(namespace, typed, ignore_override)
        return declared


class Parameters(Generic[C]):
    """Declares the parameters of a node, and updates its config when they are set.

    It logs given parameters that have no effect (unknown ones, and expert parameters that are not
    declared). It calls `approve` with each new config, which may reject it by ConfigError, and
    then `on_change`. `moved` maps parameter sections to the nodes that have them now. ConfigError
    if a value is wrong, or a parameter has moved to another node.
    """

    def __init__(
        self,
        node: Node,
        defaults: C,
        on_change: Callable[[C], None] | None = None,
        approve: Callable[[C], None] | None = None,
        moved: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self._on_change = on_change
        self._approve = approve
        given = _take_overrides(node)
        _check_places(node, given, moved)
        leaves = {leaf.name: leaf for leaf in defaults.node_params()}
        is_expert = EXPERT not in leaves or given.get(EXPERT, leaves[EXPERT].value) is True
        self._leaves = {n: leaf for n, leaf in leaves.items() if is_expert or not leaf.spec.expert}
        self.config = defaults.updated({n: v for n, v in given.items() if n in self._leaves})
        for leaf in self.config.params():
            if leaf.name in self._leaves:
                # `updated` has checked and converted the override. Its original may be an int
                # where a float is declared, which rclpy would reject.
                node.declare_parameter(
                    leaf.name, _to_ros(leaf.value), _descriptor(leaf), ignore_override=True
                )
        _warn(node, given.keys() - self._leaves.keys(), leaves)
        node.add_pre_set_parameters_callback(lambda given: [self._retyped(p) for p in given])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _retyped(self, parameter: Parameter) -> Parameter:
        leaf, value = self._leaves.get(parameter.name), parameter.value
        if leaf is not None and isinstance(leaf.value, float) and type(value) is int:
            return Parameter(parameter.name, Parameter.Type.DOUBLE, float(value))
        if leaf is not None and isinstance(leaf.value, tuple) and _from_ros(value) == ():
            return Parameter(parameter.name, Parameter.Type.STRING_ARRAY, _to_ros(()))
        return parameter

    def _updated(self, parameters: Iterable[Parameter]) -> C:
        return self.config.updated(
            {p.name: _from_ros(p.value) for p in parameters if p.name in self._leaves}
        )

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            new = self._updated(parameters)
            if self._approve is not None:
                self._approve(new)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        new = self._updated(parameters)
        if new != self.config:
            self.config = new
            if self._on_change is not None:
                self._on_change(new)


def _take_overrides(node: Node) -> dict[str, Any]:
    """Undeclare the node's parameters, except for ROS's own, and return their values by name."""
    given = node.get_parameters_by_prefix('')
    names = [name for name in given if not name.startswith(_ROS_PREFIXES)]
    for name in names:
        node.undeclare_parameter(name)
    return {name: _from_ros(given[name].value) for name in names}


def _check_places(node: Node, names: Iterable[str], moved: Mapping[str, str]) -> None:
    for name in names:
        owner = moved.get(name.partition('.')[0])
        if owner is not None:
            raise ConfigError(
                f'{name} is a parameter of {owner}, not of {node.get_name()}: move it to the '
                f'section /**/{owner} of the parameter file'
            )


def _warn(node: Node, names: Iterable[str], leaves: Mapping[str, Param]) -> None:
    """Log given parameters that have no effect, because they are not declared or do not exist."""
    hidden = sorted(name for name in names if name in leaves)
    if hidden:
        node.get_logger().warning(
            f'expert parameters have no effect unless {EXPERT}:=true is set: {", ".join(hidden)}'
        )
    for name in sorted(name for name in names if name not in leaves):
        meant = did_you_mean(name, leaves)
        node.get_logger().warning(f'no parameter is called "{name}", it has no effect{meant}')


def _from_ros(value: Any) -> Any:
    return tuple(value) if isinstance(value, list | array) else value


def _to_ros(value: Any) -> Any:
    return list(value or ('',)) if isinstance(value, tuple) else value


def _descriptor(leaf: Param) -> ParameterDescriptor:
    spec = leaf.spec
    descriptor = ParameterDescriptor(
        description=spec.description,
        read_only=spec.read_only,
        # rclpy's error for a list of the wrong type does not name the parameter; `Config`'s does.
        dynamic_typing=isinstance(leaf.value, tuple),
        additional_constraints=f'one of {", ".join(spec.choices)}' if spec.choices else '',
    )
    low, high = spec.limits
    if low == -math.inf:
        return descriptor
    if isinstance(leaf.value, float):
        limits = FloatingPointRange(from_value=float(low), to_value=float(high))
        descriptor.floating_point_range = [limits]
    elif isinstance(leaf.value, int):
        last = _INT64_MAX if high == math.inf else int(high)
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=last)]
    return descriptor
