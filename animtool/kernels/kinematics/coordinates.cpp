// Converts coordinates of joints to local transforms.
#include "kinematics/coordinates.h"

#include <cmath>

#include "base/checks.h"
#include "base/quaternions.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

constexpr std::size_t COORDINATE_COUNTS[] = {0, 1, 1, 4, 7};

}  // namespace

std::size_t JointArrays::check() const {
  const std::size_t joints = size();
  check::shape("types", types, {joints});
  check::shape("columns", columns, {joints});
  check::shape("axes", axes, {joints, 3});
  check::shape("rest_translations", rest_translations, {joints, 3});
  check::shape("rest_rotations", rest_rotations, {joints, 4});
  std::size_t width = 0;
  for (std::size_t j = 0; j < joints; ++j) {
    check::between("types", types.data()[j], 0, static_cast<std::int64_t>(Freedom::FREE));
    check::between("columns", columns.data()[j], static_cast<std::int64_t>(width),
                   static_cast<std::int64_t>(width));
    width += COORDINATE_COUNTS[types.data()[j]];
  }
  return width;
}

void local_frame(const JointArrays& joints, const double* coordinates, double* translations,
                 double* rotations) {
  for (std::size_t j = 0; j < joints.size(); ++j) {
    const double* values = coordinates + joints.columns.data()[j];
    const double* rest = joints.rest_rotations.data() + 4 * j;
    const double* axis = joints.axes.data() + 3 * j;
    double* translation = translations + 3 * j;
    double* local_rotation = rotations + 4 * j;
    std::copy(joints.rest_translations.data() + 3 * j, joints.rest_translations.data() + 3 * j + 3,
              translation);
    double rotation[4] = {0, 0, 0, 1}, offset[3], slide[3];
    switch (static_cast<Freedom>(joints.types.data()[j])) {
      case Freedom::FREE:
        ik::rotate_vector(rest, values, offset);
        for (int i = 0; i < 3; ++i) translation[i] += offset[i];
        std::copy(values + 3, values + 7, rotation);
        ik::make_unit(rotation);
        break;
      case Freedom::BALL:
        std::copy(values, values + 4, rotation);
        ik::make_unit(rotation);
        break;
      case Freedom::PIN: {
        const double sine = std::sin(values[0] / 2);
        for (int i = 0; i < 3; ++i) rotation[i] = axis[i] * sine;
        rotation[3] = std::cos(values[0] / 2);
        break;
      }
      case Freedom::SLIDE:
        for (int i = 0; i < 3; ++i) slide[i] = values[0] * axis[i];
        ik::rotate_vector(rest, slide, offset);
        for (int i = 0; i < 3; ++i) translation[i] += offset[i];
        [[fallthrough]];
      case Freedom::FIXED:
        std::copy(rest, rest + 4, local_rotation);
        continue;
    }
    ik::product(rest, rotation, local_rotation);
  }
}

LocalTransforms coordinates_to_local(In<std::int64_t, 1> types, In<std::int64_t, 1> columns,
                                     In<double, 2> axes, In<double, 2> rest_translations,
                                     In<double, 2> rest_rotations, In<double, 2> coordinates) {
  const JointArrays joints{types, columns, axes, rest_translations, rest_rotations};
  const std::size_t width = joints.check(), frames = coordinates.shape(0);
  check::shape("coordinates", coordinates, {check::ANY, width});
  Out<double, 3> translations(frames, joints.size(), 3), rotations(frames, joints.size(), 4);
  for (std::size_t f = 0; f < frames; ++f)
    local_frame(joints, coordinates.data() + f * width, translations.get() + 3 * f * joints.size(),
                rotations.get() + 4 * f * joints.size());
  return {std::move(translations), std::move(rotations)};
}

}  // namespace animtool
