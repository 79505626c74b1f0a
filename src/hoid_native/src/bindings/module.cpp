#include "bindings/module.hpp"

NB_MODULE(_native, module)
{
  // Python does not free module-level constants at exit, which nanobind would report as leaks.
  nanobind::set_leak_warnings(false);
  module.doc() = "Compiled kernels; import them from hoid_native.";
  hoid::bindings::bind_features(module);
  hoid::bindings::bind_graph(module);
  hoid::bindings::bind_matching(module);
  hoid::bindings::bind_optimize(module);
  hoid::bindings::bind_boxes(module);
  hoid::bindings::bind_masks(module);
  hoid::bindings::bind_motion(module);
  hoid::bindings::bind_objects(module);
  hoid::bindings::bind_voxels(module);
}
