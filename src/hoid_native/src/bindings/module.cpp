#include "bindings/arrays.hpp"

NB_MODULE(_native, module)
{
  // Python does not free module-level constants at exit, which nanobind would report as leaks.
  nanobind::set_leak_warnings(false);
  module.doc() = "Compiled kernels; import them from hoid_native.";
  for (const auto bind :
       {hoid::bindings::bind_features, hoid::bindings::bind_graph, hoid::bindings::bind_masks,
        hoid::bindings::bind_matching, hoid::bindings::bind_motion, hoid::bindings::bind_objects,
        hoid::bindings::bind_optimize}) {
    bind(module);
  }
}
