// The parts of the Python module, one for each folder of kernels.
#pragma once

#include <nanobind/nanobind.h>

namespace hoid::bindings {

void bind_features(nanobind::module_& module);
void bind_flow(nanobind::module_& module);
void bind_matching(nanobind::module_& module);
void bind_optimize(nanobind::module_& module);
void bind_boxes(nanobind::module_& module);
void bind_masks(nanobind::module_& module);
void bind_motion(nanobind::module_& module);

}  // namespace hoid::bindings
