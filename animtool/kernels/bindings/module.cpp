// animtool._kernels: the bindings of all subjects.
#include "bindings/subjects.h"

using namespace animtool;

NB_MODULE(_kernels, m) {
  // Objects that are still alive when a command exits are not leaks.
  nanobind::set_leak_warnings(false);
  m.doc() =
      R"(Loops that numpy cannot vectorise. They read C-contiguous arrays, and return new arrays.

Shapes, indices, counts and settings are checked: an invalid one raises a ValueError that begins
with the argument's name. NaN and infinity in coordinates, rotations, weights and values
propagate to the results, unless a function says otherwise. Times of keys, samples to fit,
points of a mesh, and frames and limits of a chain are finite.)";

  bind_capture(m);
  bind_curves(m);
  bind_kinematics(m);
  bind_skin(m);
  bind_colliders(m);
  bind_fluid(m);
  bind_crowds(m);
  bind_particles(m);
  bind_ik(m);
  bind_springs(m);
  bind_rigid(m);
}
