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

enum RowFault { kNone = 0, kCount = 1, kNotANumber = 2 };

bool is_blank(char c) { return c == ' ' || c == '\t'; }
bool is_line_end(char c) { return c == '\n' || c == '\r'; }

const char* after_line_end(const char* p, const char* end) {
  if (p == end) return p;
  if (*p == '\r' && p + 1 != end && p[1] == '\n') return p + 2;
  return p + 1;
}

}  // namespace

BvhRows parse_bvh_rows(Text given, std::size_t columns, std::size_t limit, bool final) {
  const std::string_view text = given.bytes;
  const char* const begin = text.data();
  const char* const end = begin + text.size();
  const char* p = begin;
  std::size_t rows = 0, lines = 0, found = 0;
  int fault = kNone;
  std::string bad_token;

  check::between("columns", columns, 0, std::numeric_limits<std::int32_t>::max());
  // No row is shorter than one digit and one separator a column, so the text
  // itself bounds the reservation; a row with more columns is never complete.
  const std::size_t room = std::min(columns, text.size() / 2 + 1);
  const std::size_t most = text.size() / (2 * (columns ? columns : 1)) + 1;
  const std::size_t capacity = limit < most ? limit : most;
  Out<double, 2> values(capacity, room);
  Out<std::int64_t, 1> row_lines(capacity);
  while (rows < capacity && p != end) {
    const char* const line = p;
    double* row = values.get() + rows * room;
    found = 0;
    while (true) {
      while (is_blank(*p)) ++p;
      if (p == end || is_line_end(*p)) break;
      const char* const token = p;
      double value = 0;
      const NumberKind kind = read_number(p, end, value);
      if (kind == NumberKind::malformed) {
        if (p == end && !final) break;
        fault = kNotANumber;
        bad_token.assign(token, static_cast<std::size_t>(p - token < 40 ? p - token : 40));
        break;
      }
      if (found < room) row[found] = value;
      ++found;
    }
    // A line that the text stops in is read again with what follows; so is one
    // whose carriage return may be half of a CR LF.
    if (!final && (p == end || (*p == '\r' && p + 1 == end))) {
      p = line;
      fault = kNone;
      break;
    }
    if (fault == kNone && found != 0 && found != columns) fault = kCount;
    if (fault != kNone) {
      p = line;
      break;
    }
    if (found) row_lines.get()[rows++] = static_cast<std::int64_t>(lines);
    p = after_line_end(p, end);
    ++lines;
  }
  values.cut(rows, columns);
  row_lines.cut(rows);
  return {std::move(values),
          std::move(row_lines),
          static_cast<std::size_t>(p - begin),
          lines,
          fault,
          found,
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
      const auto places = static_cast<int>(decimals.data()[j]);
      const double scaled = std::fabs(*v) * static_cast<double>(kScales[places]);
      if (!(scaled < 9e15)) {  // beyond exact integers: rare, so the C library does it
        const int n = std::snprintf(digits, sizeof digits, "%.17g", *v);
        for (int k = 0; k < n; ++k) text.push_back(digits[k] == ',' ? '.' : digits[k]);
        continue;
      }
      const auto fixed = static_cast<std::int64_t>(std::nearbyint(scaled));
      if (fixed != 0 && std::signbit(*v)) text.push_back('-');
      std::int64_t whole = fixed / kScales[places], part = fixed % kScales[places];
      char* q = digits + sizeof digits;
      int left = places;
      while (left > 0 && part % 10 == 0) part /= 10, --left;
      if (left > 0) {
        for (; left > 0; --left, part /= 10) *--q = static_cast<char>('0' + part % 10);
        *--q = '.';
      }
      do *--q = static_cast<char>('0' + whole % 10);
      while (whole /= 10);
      text.append(q, static_cast<std::size_t>(digits + sizeof digits - q));
    }
    text.push_back('\n');
  }
  return {std::move(text)};
}

}  // namespace animtool
