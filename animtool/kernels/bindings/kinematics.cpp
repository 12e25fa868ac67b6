// Python bindings of kinematics.
#include "kinematics/kinematics.h"
#include "bindings/arrays.h"
#include "bindings/subjects.h"

namespace animtool {

void bind_kinematics(nb::module_& m) {
  m.def("euler_to_quaternion", &euler_to_quaternion, WithoutLock(), "values"_a, "columns"_a,
        "axes"_a, "previous"_a,
        R"(Convert Euler angles in degrees to quaternions ``(F, R, 4)``, x y z w.

Rotation r multiplies the rotations about ``axes[r]`` (0 X, 1 Y, 2 Z) from left to right by
``values[:, columns[r]]``; a column of -1 is no rotation. Signs are those nearest to
the previous frame, and in the first frame nearest to ``previous`` ``(R, 4)``.)");

  m.def("quaternion_to_euler", &quaternion_to_euler, WithoutLock(), "quaternions"_a, "axes"_a,
        R"(Convert quaternions ``(F, R, 4)`` to Euler angles ``(F, R, 3)`` in degrees.

``axes`` ``(R, 3)`` names X, Y and Z once each. Of the equal solutions, each frame
uses the one nearest to the previous frame, and the first frame the one nearest to zero.)");

  m.def("coordinates_to_local", &coordinates_to_local, WithoutLock(), "types"_a, "columns"_a,
        "axes"_a, "rest_translations"_a, "rest_rotations"_a, "coordinates"_a,
        R"(Local translations ``(F, J, 3)`` and rotations ``(F, J, 4)`` of coordinates ``(F, Q)``.

``types`` ``(J,)``: 0 fixed, 1 pin, 2 prismatic, 3 ball, 4 free; ``columns`` ``(J,)``: the
first coordinate of each. Quaternions are normalised.)");

  m.def("forward_kinematics", &forward_kinematics, WithoutLock(), "parents"_a, "translations"_a,
        "rotations"_a, "scales"_a.none(), "positions"_a.noconvert(), "linear"_a.noconvert(),
        R"(Fill in the world origin ``(F, J, 3)`` and linear part ``(F, J, 3, 3)`` of joints.

``parents[j] < j``, -1 for a root. Local transforms are T R S, and scale is inherited.)");

  using Rest = In<double, 2>;
  using Joints = In<std::int64_t, 1>;
  using Values = In<double, 3>;
  const auto call_forward_motion =
      [](In<std::int64_t, 1> parents, Rest t_rest, Joints t_joints, Values t_values, Rest r_rest,
         Joints r_joints, Values r_values, std::optional<std::tuple<Rest, Joints, Values>> scales,
         Filled<double, 3> positions, Filled<double, 4> linear) {
        MotionArrays arrays{parents,
                            {t_rest, t_joints, t_values},
                            {r_rest, r_joints, r_values},
                            std::nullopt,
                            positions,
                            linear};
        if (scales) {
          const auto& [rest, joints, values] = *scales;
          arrays.scales = MotionChannel{rest, joints, values};
        }
        forward_motion(arrays);
      };
  m.def("forward_motion", call_forward_motion, WithoutLock(), "parents"_a, "translation_rest"_a,
        "translation_joints"_a, "translations"_a, "rotation_rest"_a, "rotation_joints"_a,
        "rotations"_a, "scales"_a.none(), "positions"_a.noconvert(), "linear"_a.noconvert(),
        R"(Fill in world transforms of joints that are animated or at rest.

``translation_rest`` ``(J, 3)``, ``translation_joints`` ``(A,)``, their ``translations``
``(F, A, 3)``; rotations likewise, and ``scales`` as a tuple of three.)");

  m.def("measure_rounding", &measure_rounding, WithoutLock(), "parents"_a, "translations"_a,
        "rotations"_a, "scales"_a.none(), "written_translations"_a, "written_rotations"_a,
        "written_scales"_a.none(),
        R"(Bounds of the written joints ``(F, 2, 3)``, and the error of rounding to float32.

Returns ``(extents, error, frame, joint)``: the largest distance between a joint's
world position in float64 and in the written values, and its frame and joint.)");

  m.def("point_errors", &point_errors, WithoutLock(), "points"_a, "true_positions"_a,
        "true_linear"_a, "positions"_a, "linear"_a,
        R"(Return the largest displacement ``(F, J)`` of the points of each joint.

Points ``(J, P, 3)`` are in the joints' frames; origins ``(F, J, 3)`` and linear
parts ``(F, J, 3, 3)`` are those of `forward_kinematics`.)");

  m.def("squared_lengths", &squared_lengths, WithoutLock(), "quaternions"_a,
        R"(Smallest and largest squared length of float32 quaternions ``(F, 4)``.

Both are NaN if a number is not finite, or if its square overflows float32.)");

  m.def("unpack_rotations", &unpack_rotations, WithoutLock(), "tracks"_a, "previous"_a.none(),
        R"(Convert J tracks of float32 quaternions ``(F, 4)`` to float64 ``(F, J, 4)``.

They have unit length, and the signs nearest to the previous frame; those of the first
frame are nearest to ``previous`` ``(J, 4)``, by default the identity.)");

  m.def("split_stretch", &split_stretch, WithoutLock(), "linear"_a,
        R"(Split linear parts ``(F, J, 3, 3)`` into a rotation after a symmetric stretch.

Returns quaternions ``(F, J, 4)`` and stretches ``(F, J, 3, 3)``, which are negative
if the linear part mirrors. A determinant below 1e-10 has quaternion zero and no
stretch.)");

  m.def("round_points", &round_points, WithoutLock(), "points"_a, "unit"_a,
        R"(Return points ``(F, V, 3)`` over ``unit`` as float32, and the rounding error.

Returns ``(rounded, error, frame, vertex)``: numbers that overflow float32 become its largest
number, and NaN stays NaN with an infinite error; the largest distance of a rounded point from
the original, multiplied by ``unit``, and its frame and vertex.)");

  m.def("continue_signs", &continue_signs, WithoutLock(), "rotations"_a, "previous"_a,
        R"(Float32 quaternions ``(F, J, 4)`` with signs continuous over frames.

The first frame continues ``previous`` ``(J, 4)``. None if all signs are already continuous.)");
}

}  // namespace animtool
