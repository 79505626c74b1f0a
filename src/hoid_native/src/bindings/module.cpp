#include "bindings/module.hpp"

NB_MODULE(_native, module)
{
  // Python frees no constants of modules at its end, such as gates.
  nanobind::set_leak_warnings(false);
  module.doc() = "The kernels; import them from hoid_native.";
  hoid::bindings::bind_features(module);
  hoid::bindings::bind_flow(module);
  hoid::bindings::bind_matching(module);
  hoid::bindings::bind_optimize(module);
  hoid::bindings::bind_boxes(module);
  hoid::bindings::bind_masks(module);
  hoid::bindings::bind_motion(module);
}
