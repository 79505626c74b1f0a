"""A node's parameters, over its services."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python

from hoid_system_tests.probe import Probe


class ParameterClient:
    """Asks a node for its parameters, as `ros2 param` does."""

    def __init__(self, probe: Probe, node: str) -> None:
        self._probe, self._node = probe, node

    def names(self) -> list[str]:
        """Return the names of all declared parameters."""
        answer = self._call(ListParameters, 'list_parameters', ListParameters.Request())
        return list(answer.result.names)

    def describe(self, names: list[str]) -> list[Any]:
        """Return the descriptors."""
        request = DescribeParameters.Request(names=names)
        return list(self._call(DescribeParameters, 'describe_parameters', request).descriptors)

    def get(self, names: list[str]) -> list[Any]:
        """Return the values."""
        request = GetParameters.Request(names=names)
        values = self._call(GetParameters, 'get_parameters', request).values
        return [parameter_value_to_python(value) for value in values]

    def set(self, values: dict[str, Any]) -> list[Any]:
        """Set parameters one by one and return the results."""
        parameters = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        request = SetParameters.Request(parameters=parameters)
        return list(self._call(SetParameters, 'set_parameters', request).results)

    def _call(self, type_: type[Any], name: str, request: Any) -> Any:
        return self._probe.call(type_, f'{self._node}/{name}', request, times=3)
