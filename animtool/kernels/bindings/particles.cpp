// Python bindings of particles.
#include "particles/particles.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_particles(nb::module_& m) {
  m.def("gravity", &gravity, WithoutLock(), "points"_a, "masses"_a, "constant"_a, "softening"_a,
        "accuracy"_a,
        R"(Gravity of N bodies, with Plummer softening.

Body j attracts i by ``constant * masses[j] * d / (d² + softening²)^1.5``. With an ``accuracy``
above 0 (0.1 at most) distant bodies are cells of an octree with quadrupoles, so that the root
mean square of relative errors is about that; with 0 each pair is summed. Coincident bodies do
not interact. Points and masses are finite, no mass is negative.

Returns ``(accelerations, potentials, rates)``: ``(N, 3)`` [m/s²], ``(N,)`` [m²/s²], and the
largest ``constant * (masses[i] + masses[j]) / (d² + softening²)^1.5`` of each body with
another ``(N,)`` [1/s²]; with a tree, only near bodies are included.)");

  m.def("molecule_pairs", &molecule_pairs, WithoutLock(), "points"_a, "box"_a, "radius"_a,
        "max_pairs"_a,
        R"(Neighbour list of N molecules within a ``radius``, in a periodic box.

Points are finite, and may be outside the box. No side of ``box`` ``(3,)`` is below twice the
reach.

Returns ``(order, starts, partners)``: molecules ordered so that neighbours are close ``(N,)``;
the first partner of each ``(N + 1,)``; and partners, as positions in that order, each pair once,
padded per molecule to multiples of four with N. More than ``max_pairs`` are refused.)");

  m.def("molecule_forces", &molecule_forces, WithoutLock(), "points"_a, "order"_a, "starts"_a,
        "partners"_a, "box"_a, "kinds"_a, "forces"_a, "charges"_a.none(), "cutoff"_a, "onset"_a,
        "damping"_a,
        R"(Forces between N molecules, by a list of `molecule_pairs`.

Two of ``kinds`` a and b have the energy ``forces[a, b, 0] / r¹² - forces[a, b, 1] / r⁶``,
switched off by a polynomial from the distance ``onset`` to ``cutoff``. ``charges`` ``(N,)`` repel
by their product, damped by erfc of ``damping`` times the distance and shifted, with the force, to
0 at the cut-off.

Returns ``(forces, energies, virial)``: ``(N, 3)``, half the pair energies of each ``(N,)``, and
the sum of forces times distances. NaN propagates.)");

  m.def("curl_noise", &curl_noise, WithoutLock(), "points"_a, "times"_a, "seed"_a,
        R"(Divergence-free noise of size 1 ``(N, 3)`` at points ``(N, 3)`` and times ``(N,)``.

Between integer times one field blends into the next.)");
}

}  // namespace animtool
