// Binding functions of each subject.
#pragma once

#include <nanobind/nanobind.h>

namespace animtool {

void bind_capture(nanobind::module_& m);
void bind_curves(nanobind::module_& m);
void bind_kinematics(nanobind::module_& m);
void bind_skin(nanobind::module_& m);
void bind_colliders(nanobind::module_& m);
void bind_fluid(nanobind::module_& m);
void bind_crowds(nanobind::module_& m);
void bind_particles(nanobind::module_& m);
void bind_ik(nanobind::module_& m);
void bind_springs(nanobind::module_& m);
void bind_rigid(nanobind::module_& m);

}  // namespace animtool
