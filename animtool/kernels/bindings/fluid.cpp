// Python bindings of fluids.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "fluid/steps.h"

namespace animtool {

void bind_fluid(nb::module_& m) {
  m.def("fluid_steps", &fluid_steps, WithoutLock(), "colliders"_a, "owners"_a, "bodies"_a,
        "state"_a, "accelerations"_a, "spacing"_a, "density"_a, "viscosity"_a, "tension"_a,
        "sound_speed"_a, "step"_a, "substeps"_a,
        R"(State of N fluid particles after a step [s], in substeps.

``state`` is positions and velocities ``(2, N, 3)``, ``accelerations`` ``(N, 3)`` [m/s²] are
constant in the step, ``colliders`` move. ``owners`` is the body of each collider, -1 for none
``(C,)``. ``bodies`` ``(B, 13)``: the inverse mass [1/kg], the inverse inertia (xx, yy, zz, xy, xz,
yz), and the centre of mass at both ends of the step [m]. ``sound_speed`` is the speed of sound [m/s],
at most a spacing per substep; ``tension`` is the surface tension [N/m].

Returns ``(state, pressures, impulses, compression)``: pressures are means over the step ``(N,)``
[Pa]; impulses on bodies ``(2, B, 6)`` [N s] with angular impulses about the origin, and the same
multiplied by their time before the end; compression is the mean over the particles.)");

  m.def("fluid_densities", &fluid_densities, WithoutLock(), "colliders"_a, "points"_a, "spacing"_a,
        R"(Densities of a fluid at its particles ``(N, 3)``, over the rest density ``(N,)``.

The first poses of ``colliders`` are used, as walls that are as dense as the adjacent fluid.)");

  m.def("fluid_area", &fluid_area, WithoutLock(), "points"_a, "spacing"_a,
        R"(Area of a fluid's free surface around its particles ``(N, 3)`` [m²].

Surface tension is its gradient. Walls are not fluid.)");
}

}  // namespace animtool
