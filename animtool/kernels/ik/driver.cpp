// Evaluates programs of driven joints.
#include "ik/driver.h"

namespace animtool::ik {

void Evaluation::run(std::size_t p) {
  const Program& program = programs_[p];
  slope_count_ = program.dofs.size();
  top_ = 0;
  std::size_t point_count = 0;
  for (std::size_t i = 0; i < program.instructions.size(); ++i) {
    const Instruction& instruction = program.instructions[i];
    if (instruction.op == Op::POINT) {
      ++point_count;
      continue;
    }
    apply(program, instruction, &instruction - point_count);
    point_count = 0;
  }
  results_.values[p] = entry(0)[0];
  std::copy(entry(0) + 1, entry(0) + 1 + slope_count_, &results_.slopes[program.first_slope]);
}

void Evaluation::replace_operands(int count, double value, double a, double b, double c) {
  top_ -= count - 1;
  double* top = entry(top_ - 1);
  const double derivatives[3] = {a, b, c};
  top[0] = value;
  for (std::size_t s = 1; s <= slope_count_; ++s) {
    double sum = 0;
    for (int k = 0; k < count; ++k)
      // The derivative by an operand that does not depend on a coordinate is 0, even if the slope
      // is infinite.
      if (entry(top_ - 1 + k)[s] != 0) sum += derivatives[k] * entry(top_ - 1 + k)[s];
    top[s] = sum;
  }
}

void Evaluation::apply(const Program& program, const Instruction& instruction,
                       const Instruction* points) {
  const double* n = instruction.numbers;
  switch (instruction.op) {
    case Op::NUMBER:
      push(n[0]);
      return;
    case Op::COORDINATE:
      push(n[0] * q_[instruction.index])[instruction.first_slot] = n[0];
      return;
    case Op::BALL:
      push_ball(instruction);
      return;
    case Op::RESULT:
      push_result(program, instruction);
      return;
    case Op::POINT:
      return;
    case Op::CURVE:
      apply_curve(instruction, points);
      return;
    default:
      apply_function(instruction.op);
  }
}

void Evaluation::push_ball(const Instruction& instruction) {
  const double* n = instruction.numbers;
  const BallParts ball = split_ball(q_ + instruction.index, n[4]);
  const double angle = std::hypot(ball.swing[0], ball.swing[1]);
  const double swing_slopes[2] = {angle > 0 ? n[3] * ball.swing[0] / angle : 0,
                                  angle > 0 ? n[3] * ball.swing[1] / angle : 0};
  double* slopes =
      push(n[0] * ball.twist + n[1] * ball.swing[0] + n[2] * ball.swing[1] + n[3] * angle);
  for (int i = 0; i < 3; ++i)
    slopes[instruction.first_slot + i] = n[0] * ball.slopes[2][i] +
                                         (n[1] + swing_slopes[0]) * ball.slopes[0][i] +
                                         (n[2] + swing_slopes[1]) * ball.slopes[1][i];
}

void Evaluation::push_result(const Program& program, const Instruction& instruction) {
  const Program& other_program = programs_[instruction.index];
  double* slopes = push(instruction.numbers[0] * results_.values[instruction.index]);
  for (std::size_t k = 0; k < other_program.dofs.size(); ++k) {
    const auto entry =
        std::lower_bound(program.dofs.begin(), program.dofs.end(), other_program.dofs[k]);
    slopes[entry - program.dofs.begin()] =
        instruction.numbers[0] * results_.slopes[other_program.first_slope + k];
  }
}

void Evaluation::apply_curve(const Instruction& instruction, const Instruction* points) {
  const double x = entry(top_ - 1)[0];
  const int count = instruction.index;
  const double* first_point = points[0].numbers;
  const double* last_point = points[count - 1].numbers;
  if (!(x > first_point[0])) return replace_operands(1, x == x ? first_point[1] : x, 0);
  if (!(x < last_point[0])) return replace_operands(1, last_point[1], 0);
  int low = 0, high = count - 1;
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    (points[middle].numbers[0] <= x ? low : high) = middle;
  }
  const double *a = points[low].numbers, *b = points[high].numbers;
  const double interval = b[0] - a[0], u = (x - a[0]) / interval, y_change = b[1] - a[1];
  if (!(instruction.numbers[0] > 0))
    return replace_operands(1, a[1] + u * y_change, y_change / interval);
  const double start_slope = a[2] * interval, end_slope = b[2] * interval;
  // Hermite: h(u) = u^2 (3 - 2 u) rise + u (1 - u)^2 start_slope - u^2 (1 - u) end_slope
  const double value =
      a[1] + u * u * (3 - 2 * u) * y_change + u * (1 - u) * ((1 - u) * start_slope - u * end_slope);
  const double slope = 6 * u * (1 - u) * y_change + (1 - u) * (1 - 3 * u) * start_slope +
                       u * (3 * u - 2) * end_slope;
  replace_operands(1, value, slope / interval);
}

void Evaluation::apply_function(Op op) {
  const int count = count_operands(op);
  double x[3] = {0, 0, 0};
  for (int k = 0; k < count; ++k) x[k] = entry(top_ - count + k)[0];
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
      const bool is_above = low > x[2], is_below = x[0] < x[1];
      return replace_operands(3, std::min(low, x[2]), !is_above && !is_below, !is_above && is_below,
                              is_above);
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
      return apply_smoothstep(x);
    case Op::SQRT:
      return replace_operands(1, std::sqrt(x[0]), 0.5 / std::sqrt(x[0]));
    case Op::TAN:
      return replace_operands(1, std::tan(x[0]), 1 + std::tan(x[0]) * std::tan(x[0]));
    default:
      return;
  }
}

void Evaluation::apply_smoothstep(const double* x) {
  const double width = x[1] - x[0];
  if (width == 0) return replace_operands(3, x[2] < x[0] ? 0 : 1, 0, 0, 0);
  const double unclamped_fraction = (x[2] - x[0]) / width,
               u = std::clamp(unclamped_fraction, 0.0, 1.0);
  const double slope = unclamped_fraction == u ? 6 * u * (1 - u) / width : 0;
  replace_operands(3, u * u * (3 - 2 * u), slope * (u - 1), -slope * u, slope);
}

}  // namespace animtool::ik
