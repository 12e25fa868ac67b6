// Python bindings of particles.
#include "bindings/arrays.h"
#include "bindings/subjects.h"
#include "particles/particles.h"

namespace animtool {

void bind_particles(nb::module_& m) {
  m.def("gravity", &gravity, Unlocked(), "points"_a, "masses"_a, "constant"_a, "softening"_a,
        "accuracy"_a,
        R"(Sum what N bodies pull each other by, with Plummer softening.

Body j pulls i by ``constant * masses[j] * d / (d² + softening²)^1.5``. With an ``accuracy``
above 0 (0.1 at most) distant bodies count as cells of an octree with quadrupoles, such that
the root mean square of relative errors is about that; with 0 each pair is summed. Bodies at
one place do not act on each other. Points and masses are finite, no mass is below 0.

Returns ``(accelerations, potentials, rates)``: ``(N, 3)`` [m/s²], ``(N,)`` [m²/s²], and the
largest ``constant * (masses[i] + masses[j]) / (d² + softening²)^1.5`` of each body with
another ``(N,)`` [1/s²], of the tree with those that are near alone.)");

  m.def("molecule_pairs", &molecule_pairs, Unlocked(), "points"_a, "box"_a, "reach"_a, "most"_a,
        R"(List the pairs of N molecules within a reach, in a box that goes on at its ends.

Points are finite, from anywhere; no side of ``box`` ``(3,)`` is below twice the reach.

Returns ``(order, starts, partners)``: molecules in an order in which those near are near
``(N,)``; where partners of each of these begin ``(N + 1,)``; and partners, as places of that
order, each pair once, those of a molecule filled up to multiples of four with N. More than
``most`` are refused.)");

  m.def("molecule_forces", &molecule_forces, Unlocked(), "points"_a, "order"_a, "starts"_a,
        "partners"_a, "box"_a, "kinds"_a, "forces"_a, "charges"_a.none(), "cutoff"_a, "onset"_a,
        "damping"_a,
        R"(Sum what N molecules do to each other by a list of `molecule_pairs`.

Two of ``kinds`` a and b have the energy ``forces[a, b, 0] / r¹² - forces[a, b, 1] / r⁶``,
which from the distance ``onset`` on is switched off by a polynomial that ends at ``cutoff``.
``charges`` ``(N,)`` repel by their product, damped by erfc of ``damping`` times the distance
and shifted, with the force, to 0 at the cut-off.

Returns ``(forces, energies, virial)``: ``(N, 3)``, half the energies of the pairs of each
``(N,)``, and the sum of forces times distances. NaN goes through.)");

  m.def("curl_noise", &curl_noise, Unlocked(), "points"_a, "times"_a, "seed"_a,
        R"(Swirls of size 1 without divergence ``(N, 3)`` at points ``(N, 3)`` and times ``(N,)``.

Between whole times one field goes over into the next.)");
}

}  // namespace animtool
