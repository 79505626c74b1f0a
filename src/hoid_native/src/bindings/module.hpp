// Each function binds the kernels of one folder.
#pragma once

#include <nanobind/nanobind.h>

namespace hoid::bindings {

void bind_features(nanobind::module_& module);
void bind_graph(nanobind::module_& module);
void bind_matching(nanobind::module_& module);
void bind_optimize(nanobind::module_& module);
void bind_boxes(nanobind::module_& module);
void bind_masks(nanobind::module_& module);
void bind_motion(nanobind::module_& module);
void bind_objects(nanobind::module_& module);
void bind_voxels(nanobind::module_& module);

}  // namespace hoid::bindings
