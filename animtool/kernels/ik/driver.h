// Driven joints: their values are expressions of other joints; derivatives by forward mode.
//
// A program is an expression in reverse Polish notation, of coordinates and of results of earlier
// programs. Its derivatives are by the degrees of freedom that it reads.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/quaternions.h"

namespace animtool::ik {

// Operations, numbered as in animtool.ik.driver_programs; the functions are those of a rig's
// expressions.
enum class Op {
  NUMBER,
  COORDINATE,
  BALL,
  RESULT,
  POINT,
  CURVE,
  ADD,
  SUBTRACT,
  MULTIPLY,
  DIVIDE,
  NEGATE,
  ABS,
  ATAN2,
  CEIL,
  CLAMP,
  COS,
  EXP,
  FLOOR,
  LERP,
  LOG,
  MAX,
  MIN,
  POW,
  SIGN,
  SIN,
  SMOOTHSTEP,
  SQRT,
  TAN,
  COUNT
};

// Numbers of an instruction.
constexpr int MAX_NUMBERS = 6;
// Largest stack depth of a program, and largest number of derivatives of a value.
constexpr std::size_t MAX_STACK_DEPTH = 1024, MAX_SLOPES = 1024;

// Number of operands of an operation.
inline int count_operands(Op op) {
  switch (op) {
    case Op::NUMBER:
    case Op::COORDINATE:
    case Op::BALL:
    case Op::RESULT:
    case Op::POINT:
      return 0;
    case Op::CLAMP:
    case Op::LERP:
    case Op::SMOOTHSTEP:
      return 3;
    case Op::ADD:
    case Op::SUBTRACT:
    case Op::MULTIPLY:
    case Op::DIVIDE:
    case Op::ATAN2:
    case Op::MAX:
    case Op::MIN:
    case Op::POW:
      return 2;
    default:
      return 1;
  }
}

struct Instruction {
  Op op;
  // COORDINATE and BALL: index of the coordinate; RESULT: index of the program; CURVE: number of
  // its points.
  int index;
  // NUMBER: its value; POINT: x, y, slope; CURVE: whether it is smooth; COORDINATE: scale; BALL:
  // factors of the twist, of the swing about x and y, and of the swing angle, and the middle of the
  // twist's range.
  double numbers[MAX_NUMBERS];
  int first_slot;  // index of its first degree of freedom among those of the program
};

// The expression of one driven value.
struct Program {
  std::vector<Instruction> instructions;
  std::vector<int> dofs;        // degrees of freedom that it depends on, ascending
  std::size_t first_slope = 0;  // index of its first slope among those of all programs
  std::size_t depth = 0;        // largest stack depth
};

// Values of programs at a pose, and their derivatives.
struct Results {
  std::vector<double> values, slopes;
  std::vector<double> stack;
};

// Twist and swing of a ball, and their derivatives for q <- exp(d) q.
struct BallParts {
  double twist, swing[2];
  double slopes[3][3];
};

// Splits a ball's motion into twist and swing (see ik/limits.cpp).
BallParts split_ball(const double* q, double middle);

// Evaluates programs in order at a pose.
class Evaluation {
 public:
  Evaluation(const std::vector<Program>& programs, const double* q, Results& results)
      : programs_(programs), q_(q), results_(results) {}

  void run() {
    for (std::size_t p = 0; p < programs_.size(); ++p) run(p);
  }

 private:
  void run(std::size_t p);

  // A value on the stack, followed by its derivatives.
  double* entry(std::size_t i) { return &results_.stack[i * (1 + slope_count_)]; }

  // Pushes a value; returns its derivatives, which are 0.
  double* push(double value) {
    double* top = entry(top_++);
    top[0] = value;
    std::fill(top + 1, top + 1 + slope_count_, 0.0);
    return top + 1;
  }

  // Replaces one, two or three operands by a value, with its derivatives by each of them.
  void replace_operands(int count, double value, double a, double b = 0, double c = 0);

  void apply(const Program& program, const Instruction& instruction, const Instruction* points);

  void push_ball(const Instruction& instruction);

  void push_result(const Program& program, const Instruction& instruction);

  void apply_curve(const Instruction& instruction, const Instruction* points);

  void apply_function(Op op);

  void apply_smoothstep(const double* x);

  const std::vector<Program>& programs_;
  const double* q_;
  Results& results_;
  std::size_t slope_count_ = 0, top_ = 0;
};

}  // namespace animtool::ik
