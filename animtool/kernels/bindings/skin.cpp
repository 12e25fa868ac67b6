// Python bindings of skin.
#include "skin/skin.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_skin(nb::module_& m) {
  m.def("skin_linear", &skin_linear, WithoutLock(), "points"_a, "first"_a, "joints"_a, "weights"_a,
        "transforms"_a, "normalizes"_a, "out"_a.noconvert(),
        R"(Fill in points ``(F, V, 3)`` moved by the weighted sum of joints' transforms.

Points are ``(F, V, 3)``, or ``(1, V, 3)`` if they do not move. Vertex v follows
``joints[first[v]:first[v + 1]]`` with the weights at the same indices. Transforms are
``(F, U, 3, 4)``, for column vectors. ``normalizes`` scales results to length 1.)");

  m.def("skin_dual_quaternion", &skin_dual_quaternion, WithoutLock(), "points"_a, "first"_a,
        "joints"_a, "weights"_a, "rotations"_a, "translations"_a, "stretches"_a.none(),
        "normalizes"_a, "out"_a.noconvert(),
        R"(Fill in points ``(F, V, 3)`` moved by the weighted sum of dual quaternions.

Like `skin_linear`, with unit quaternions ``(F, U, 4)`` and translations ``(F, U, 3)``. The
first influence of a vertex determines the sign of the others. Symmetric ``stretches``
``(F, U, 3, 3)`` are blended linearly and applied first.)");

  m.def("add_sparse", &add_sparse, WithoutLock(), "points"_a, "weights"_a, "first"_a, "columns"_a,
        "offsets"_a, "out"_a.noconvert(),
        R"(Fill in points plus the weighted sum of sparse offsets, as ``(F, V, 3)``.

``out`` may be the points themselves. Points are ``(F or 1, V, 3)``, weights ``(F, C)``. Vertex v has the offsets
``first[v]`` to ``first[v + 1]``, each ``(3,)`` of the column in ``columns``.)");

  m.def("point_extents", &point_extents, WithoutLock(), "points"_a,
        R"(Smallest and largest coordinates ``(F, 2, 3)`` of points ``(F, V, 3)``.)");
}

}  // namespace animtool
