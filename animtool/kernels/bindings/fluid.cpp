// Python bindings of fluids.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "fluid/steps.h"

namespace animtool {

void bind_fluid(nb::module_& m) {
  m.def("fluid_steps", &fluid_steps, Unlocked(), "colliders"_a, "owners"_a, "bodies"_a, "state"_a,
        "accelerations"_a, "spacing"_a, "density"_a, "viscosity"_a, "tension"_a, "sound"_a,
        "step"_a, "parts"_a,
        R"(Where N particles of a fluid are a step [s] later, in some parts of it.

``state`` is positions and velocities ``(2, N, 3)``, ``accelerations`` ``(N, 3)`` [m/s²] last
for the step, ``colliders`` move over it. ``owners`` names the body that each collider is
of, -1 for none ``(C,)``. ``bodies`` ``(B, 13)``: the inverse mass [1/kg], the inverse inertia
(xx, yy, zz, xy, xz, yz), and the centre of mass at both ends of the step [m]. ``sound`` is how fast
pressure goes [m/s], up to a spacing in a part; ``tension`` is that of the surface [N/m].

Returns ``(state, pressures, impulses, compression)``: pressures are means over the step
``(N,)`` [Pa]; impulses on bodies ``(2, B, 6)`` [N s] with moments about the origin, and
times how long before the end they were; compression is the mean over the particles.)");

  m.def("fluid_densities", &fluid_densities, Unlocked(), "colliders"_a, "points"_a, "spacing"_a,
        R"(Densities of a fluid at its particles ``(N, 3)``, over that at rest ``(N,)``.

The first poses of ``colliders`` count, as walls that are as dense as what is before them.)");

  m.def("fluid_area", &fluid_area, Unlocked(), "points"_a, "spacing"_a,
        R"(Area of the free surface of a fluid about its particles ``(N, 3)`` [m²].

Surface tension is what this costs: forces are its slopes. Walls are not fluid.)");
}

}  // namespace animtool
