// Evaluates programs of driven joints.
#include "ik/driver.h"

namespace animtool::ik {

void Evaluation::run(std::size_t p) {
  const Program& program = programs_[p];
  slots_ = program.dofs.size();
  top_ = 0;
  std::size_t points = 0;
  for (std::size_t i = 0; i < program.instructions.size(); ++i) {
    const Instruction& one = program.instructions[i];
    if (one.op == Op::POINT) {
      ++points;
      continue;
    }
    apply(program, one, &one - points);
    points = 0;
  }
  results_.values[p] = at(0)[0];
  std::copy(at(0) + 1, at(0) + 1 + slots_, &results_.slopes[program.first]);
}

void Evaluation::replace_operands(int count, double value, double a, double b, double c) {
  top_ -= count - 1;
  double* top = at(top_ - 1);
  const double by[3] = {a, b, c};
  top[0] = value;
  for (std::size_t s = 1; s <= slots_; ++s) {
    double sum = 0;
    for (int k = 0; k < count; ++k)
      // The derivative by what a value does not depend on is 0, even if the slope is infinite.
      if (at(top_ - 1 + k)[s] != 0) sum += by[k] * at(top_ - 1 + k)[s];
    top[s] = sum;
  }
}

void Evaluation::apply(const Program& program, const Instruction& one, const Instruction* points) {
  const double* n = one.numbers;
  switch (one.op) {
    case Op::NUMBER:
      push(n[0]);
      return;
    case Op::COORDINATE:
      push(n[0] * q_[one.which])[one.slot] = n[0];
      return;
    case Op::BALL:
      ball(one);
      return;
    case Op::RESULT:
      result(program, one);
      return;
    case Op::POINT:
      return;
    case Op::CURVE:
      curve(one, points);
      return;
    default:
      function(one.op);
  }
}

void Evaluation::ball(const Instruction& one) {
  const double* n = one.numbers;
  const BallParts parts = ball_parts(q_ + one.which, n[4]);
  const double angle = std::hypot(parts.swing[0], parts.swing[1]);
  const double by[2] = {angle > 0 ? n[3] * parts.swing[0] / angle : 0,
                        angle > 0 ? n[3] * parts.swing[1] / angle : 0};
  double* slopes =
      push(n[0] * parts.twist + n[1] * parts.swing[0] + n[2] * parts.swing[1] + n[3] * angle);
  for (int i = 0; i < 3; ++i)
    slopes[one.slot + i] = n[0] * parts.slopes[2][i] + (n[1] + by[0]) * parts.slopes[0][i] +
                           (n[2] + by[1]) * parts.slopes[1][i];
}

void Evaluation::result(const Program& program, const Instruction& one) {
  const Program& other = programs_[one.which];
  double* slopes = push(one.numbers[0] * results_.values[one.which]);
  for (std::size_t k = 0; k < other.dofs.size(); ++k) {
    const auto position = std::lower_bound(program.dofs.begin(), program.dofs.end(), other.dofs[k]);
    slopes[position - program.dofs.begin()] = one.numbers[0] * results_.slopes[other.first + k];
  }
}

void Evaluation::curve(const Instruction& one, const Instruction* points) {
  const double x = at(top_ - 1)[0];
  const int count = one.which;
  const double* first = points[0].numbers;
  const double* last = points[count - 1].numbers;
  if (!(x > first[0])) return replace_operands(1, x == x ? first[1] : x, 0);
  if (!(x < last[0])) return replace_operands(1, last[1], 0);
  int low = 0, high = count - 1;
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    (points[middle].numbers[0] <= x ? low : high) = middle;
  }
  const double *a = points[low].numbers, *b = points[high].numbers;
  const double span = b[0] - a[0], u = (x - a[0]) / span, rise = b[1] - a[1];
  if (!(one.numbers[0] > 0)) return replace_operands(1, a[1] + u * rise, rise / span);
  const double p = a[2] * span, r = b[2] * span;
  // Hermite: h(u) = u^2 (3 - 2 u) rise + u (1 - u)^2 p - u^2 (1 - u) r
  const double value = a[1] + u * u * (3 - 2 * u) * rise + u * (1 - u) * ((1 - u) * p - u * r);
  const double slope = 6 * u * (1 - u) * rise + (1 - u) * (1 - 3 * u) * p + u * (3 * u - 2) * r;
  replace_operands(1, value, slope / span);
}

void Evaluation::function(Op op) {
  const int count = arguments(op);
  double x[3] = {0, 0, 0};
  for (int k = 0; k < count; ++k) x[k] = at(top_ - count + k)[0];
  switch (op) {
    case Op::ADD:
      return replace_operands(2, x[0] + x[1], 1, 1);
    case Op::SUBTRACT:
      return replace_operands(2, x[0] - x[1], 1, -1);
    case Op::MULTIPLY:
      return replace_operands(2, x[0] * x[1], x[1], x[0]);
    case Op::DIVIDE:
      return replace_operands(2, x[0] / x[1], 1 / x[1], -x[0] / x[1] / x[1]);
    case Op::NEGATE:
      return replace_operands(1, -x[0], -1);
    case Op::ABS:
      return replace_operands(1, std::fabs(x[0]), x[0] < 0 ? -1 : x[0] > 0);
    case Op::ATAN2: {
      const double square = x[0] * x[0] + x[1] * x[1];
      return replace_operands(2, std::atan2(x[0], x[1]), x[1] / square, -x[0] / square);
    }
    case Op::CEIL:
      return replace_operands(1, std::ceil(x[0]), 0);
    case Op::CLAMP: {
      const double low = std::max(x[0], x[1]);
      const bool above = low > x[2], below = x[0] < x[1];
      return replace_operands(3, std::min(low, x[2]), !above && !below, !above && below, above);
    }
    case Op::COS:
      return replace_operands(1, std::cos(x[0]), -std::sin(x[0]));
    case Op::EXP:
      return replace_operands(1, std::exp(x[0]), std::exp(x[0]));
    case Op::FLOOR:
      return replace_operands(1, std::floor(x[0]), 0);
    case Op::LERP:
      return replace_operands(3, x[0] + (x[1] - x[0]) * x[2], 1 - x[2], x[2], x[1] - x[0]);
    case Op::LOG:
      return replace_operands(1, std::log(x[0]), 1 / x[0]);
    case Op::MAX:
      return replace_operands(2, std::max(x[0], x[1]), x[0] >= x[1], x[0] < x[1]);
    case Op::MIN:
      return replace_operands(2, std::min(x[0], x[1]), x[0] <= x[1], x[0] > x[1]);
    case Op::POW: {
      const double value = std::pow(x[0], x[1]);
      return replace_operands(2, value, x[1] * std::pow(x[0], x[1] - 1), value * std::log(x[0]));
    }
    case Op::SIGN:
      return replace_operands(1, x[0] < 0 ? -1 : x[0] > 0, 0);
    case Op::SIN:
      return replace_operands(1, std::sin(x[0]), std::cos(x[0]));
    case Op::SMOOTHSTEP:
      return smoothstep(x);
    case Op::SQRT:
      return replace_operands(1, std::sqrt(x[0]), 0.5 / std::sqrt(x[0]));
    case Op::TAN:
      return replace_operands(1, std::tan(x[0]), 1 + std::tan(x[0]) * std::tan(x[0]));
    default:
      return;
  }
}

void Evaluation::smoothstep(const double* x) {
  const double width = x[1] - x[0];
  if (width == 0) return replace_operands(3, x[2] < x[0] ? 0 : 1, 0, 0, 0);
  const double raw = (x[2] - x[0]) / width, u = std::clamp(raw, 0.0, 1.0);
  const double slope = raw == u ? 6 * u * (1 - u) / width : 0;
  replace_operands(3, u * u * (3 - 2 * u), slope * (u - 1), -slope * u, slope);
}

}  // namespace animtool::ik
