// The rows of numbers of a BVH file's MOTION block: text to float64 and back.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include "base/checks.h"
#include "capture/capture.h"
#include "capture/numbers.h"

namespace animtool {

namespace {

// Why a row could not be read.
enum RowFault { kNoFault = 0, kWrongCount = 1, kNotANumber = 2 };

bool is_blank(char c) { return c == ' ' || c == '\t'; }
bool is_line_end(char c) { return c == '\n' || c == '\r'; }

// The position after a line end, which may be CR, LF or CR LF.
const char* after_line_end(const char* p, const char* end) {
  if (p == end) return p;
  if (*p == '\r' && p + 1 != end && p[1] == '\n') return p + 2;
  return p + 1;
}

}  // namespace

BvhRows parse_bvh_rows(Text source, std::size_t columns, std::size_t limit, bool is_final) {
  const std::string_view text = source.bytes;
  const char* const begin = text.data();
  const char* const end = begin + text.size();
  const char* p = begin;
  std::size_t row_count = 0, line_count = 0, token_count = 0;
  int fault = kNoFault;
  std::string bad_token;

  check::between("columns", columns, 0, std::numeric_limits<std::int32_t>::max());
  // A row has at least one digit and one separator per column, so the length of the text bounds the
  // allocation; a row with more columns is never complete.
  const std::size_t row_capacity = std::min(columns, text.size() / 2 + 1);
  const std::size_t max_rows = text.size() / (2 * (columns ? columns : 1)) + 1;
  const std::size_t capacity = limit < max_rows ? limit : max_rows;
  Out<double, 2> values(capacity, row_capacity);
  Out<std::int64_t, 1> row_lines(capacity);
  while (row_count < capacity && p != end) {
    const char* const line = p;
    double* row = values.get() + row_count * row_capacity;
    token_count = 0;
    while (true) {
      while (is_blank(*p)) ++p;
      if (p == end || is_line_end(*p)) break;
      const char* const token = p;
      double value = 0;
      const NumberKind kind = read_number(p, end, value);
      if (kind == NumberKind::malformed) {
        if (p == end && !is_final) break;
        fault = kNotANumber;
        bad_token.assign(token, static_cast<std::size_t>(p - token < 40 ? p - token : 40));
        break;
      }
      if (token_count < row_capacity) row[token_count] = value;
      ++token_count;
    }
    // An incomplete last line is read again with the text that follows; so is one whose carriage
    // return may be half of a CR LF.
    if (!is_final && (p == end || (*p == '\r' && p + 1 == end))) {
      p = line;
      fault = kNoFault;
      break;
    }
    if (fault == kNoFault && token_count != 0 && token_count != columns) fault = kWrongCount;
    if (fault != kNoFault) {
      p = line;
      break;
    }
    if (token_count) row_lines.get()[row_count++] = static_cast<std::int64_t>(line_count);
    p = after_line_end(p, end);
    ++line_count;
  }
  values.truncate(row_count, columns);
  row_lines.truncate(row_count);
  return {std::move(values),
          std::move(row_lines),
          static_cast<std::size_t>(p - begin),
          line_count,
          fault,
          token_count,
          Bytes{std::move(bad_token)}};
}

Bytes format_bvh_rows(In<double, 2> values, In<std::int64_t, 1> decimals) {
  const std::size_t rows = values.shape(0), columns = values.shape(1);
  check::shape("values", values, {check::ANY, check::ANY});
  check::shape("decimals", decimals, {columns});
  check::indices("decimals", decimals, 0, 10);
  std::string text;
  static constexpr std::int64_t kScales[] = {1,      10,      100,      1000,      10000,
                                             100000, 1000000, 10000000, 100000000, 1000000000};
  text.reserve(rows * columns * 12);
  const double* v = values.data();
  char digits[400];
  for (std::size_t i = 0; i < rows; ++i) {
    for (std::size_t j = 0; j < columns; ++j, ++v) {
      if (j) text.push_back(' ');
      const auto digits_after = static_cast<int>(decimals.data()[j]);
      const double scaled = std::fabs(*v) * static_cast<double>(kScales[digits_after]);
      if (!(scaled < 9e15)) {  // larger than exact integers: rare, so the C library formats it
        const int n = std::snprintf(digits, sizeof digits, "%.17g", *v);
        for (int k = 0; k < n; ++k) text.push_back(digits[k] == ',' ? '.' : digits[k]);
        continue;
      }
      const auto fixed_point = static_cast<std::int64_t>(std::nearbyint(scaled));
      if (fixed_point != 0 && std::signbit(*v)) text.push_back('-');
      std::int64_t integer = fixed_point / kScales[digits_after],
                   decimal_part = fixed_point % kScales[digits_after];
      char* q = digits + sizeof digits;
      int digits_left = digits_after;
      while (digits_left > 0 && decimal_part % 10 == 0) decimal_part /= 10, --digits_left;
      if (digits_left > 0) {
        for (; digits_left > 0; --digits_left, decimal_part /= 10)
          *--q = static_cast<char>('0' + decimal_part % 10);
        *--q = '.';
      }
      do *--q = static_cast<char>('0' + integer % 10);
      while (integer /= 10);
      text.append(q, static_cast<std::size_t>(digits + sizeof digits - q));
    }
    text.push_back('\n');
  }
  return {std::move(text)};
}

}  // namespace animtool
