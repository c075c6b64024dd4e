#include "export/evaluation_report.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace iris::exporters {
namespace {

std::string value_text(const Figure& figure) {
  const double v = figure.value;
  if (std::isinf(v)) return "infinite";
  if (std::isnan(v)) return "-";
  if (figure.unit.empty()) return fmt::format("{:.0f}", v);
  if (figure.unit == "m") {
    return std::abs(v) < 0.1 ? fmt::format("{:.2f} mm", 1000 * v) : fmt::format("{:.3f} m", v);
  }
  if (figure.unit == "deg/m") return fmt::format("{:.4f} deg/m", v);
  if (figure.unit == "1") return fmt::format("{:.3f}", v);
  const int digits = figure.unit == "deg" || figure.unit == "px" ? 3 : 2;
  return fmt::format("{:.{}f} {}", v, digits, figure.unit);
}

std::string cell_text(const std::variant<std::string, double>& cell, int digits) {
  if (const auto* text = std::get_if<std::string>(&cell)) return *text;
  const double value = std::get<double>(cell);
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : "-";
}

// A note in brackets, broken between words.
std::string note_text(const std::string& note) {
  constexpr size_t kWidth = 120;
  std::string text, line = "  (";
  bool first = true;
  for (size_t at = 0; at <= note.size();) {
    const size_t end = std::min(note.find(' ', at), note.size());
    const std::string word = note.substr(at, end - at);
    if (!first && line.size() + 1 + word.size() + 1 > kWidth) {  // with the closing bracket
      text += line + "\n";
      line = "   " + word;
    } else {
      line += (first ? "" : " ") + word;
    }
    first = false;
    at = end + 1;
  }
  return text + line + ")\n";
}

std::string table_text(const FigureTable& table) {
  std::vector<std::vector<std::string>> lines(1);
  for (const FigureTable::Column& column : table.columns) lines[0].push_back(column.label);
  for (const auto& row : table.rows) {
    lines.emplace_back();
    for (size_t i = 0; i < row.size(); ++i) lines.back().push_back(cell_text(row[i], table.columns[i].digits));
  }
  std::vector<size_t> widths(table.columns.size());
  for (const auto& line : lines) {
    for (size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  }
  std::string text = fmt::format("\n  {}\n", table.title);
  for (const auto& line : lines) {
    std::string row = " ";
    for (size_t i = 0; i < line.size(); ++i) {
      // Words to the left, numbers to the right.
      const bool words = !table.rows.empty() && std::holds_alternative<std::string>(table.rows[0][i]);
      row += words ? fmt::format(" {:<{}} ", line[i], widths[i]) : fmt::format(" {:>{}} ", line[i], widths[i]);
    }
    row.erase(row.find_last_not_of(' ') + 1);
    text += row + "\n";
  }
  return text;
}

}  // namespace

std::string Evaluation::summary() const {
  struct Item {
    const char *section, *figure, *words;
  };
  constexpr Item kItems[] = {{"trajectory", "ate_rmse", "position error (ATE)"},
                             {"trajectory", "drift_translation", "drift"},
                             {"disparities", "wrong_1px", "wrong disparities"},
                             {"map", "occupied_precision", "map precision"},
                             {"map", "occupied_recall", "map recall"},
                             {"image", "psnr", "PSNR"},
                             {"image", "ssim", "SSIM"}};
  constexpr double kDisagree = 2;  // times
  std::vector<std::string> parts;
  for (const Item& item : kItems) {
    for (const FigureSection& section : sections) {
      if (section.name != item.section) continue;
      for (const Figure& figure : section.figures) {
        if (figure.name == item.figure) parts.push_back(fmt::format("{} {}", item.words, value_text(figure)));
      }
    }
  }
  for (const FigureSection& section : sections) {
    for (const Figure& figure : section.figures) {
      if (section.name != "trajectory" || figure.name != "error_ratio") continue;
      if (figure.value < kDisagree && figure.value > 1 / kDisagree) continue;
      parts.push_back(fmt::format("the path's errors are {:.2g} times the stated ones", figure.value));
    }
  }
  return fmt::format("{}", fmt::join(parts, ", "));
}

std::string Evaluation::text() const {
  std::string text = summary();
  if (!text.empty()) text += "\n";
  for (const FigureSection& section : sections) {
    if (!text.empty()) text += "\n";
    text += section.title + "\n";
    for (const std::string& note : section.notes) text += note_text(note);
    size_t width = 0;
    for (const Figure& figure : section.figures) width = std::max(width, figure.label.size());
    for (const Figure& figure : section.figures) {
      text += fmt::format("  {:<{}}  {:>14}\n", figure.label, width, value_text(figure));
    }
    for (const FigureTable& table : section.tables) {
      if (!table.rows.empty()) text += table_text(table);
    }
  }
  return text;
}

std::string Evaluation::json() const {
  nlohmann::ordered_json root;
  root["estimate"] = estimate;
  root["truth"] = truth;
  const auto number = [](double v) { return std::isfinite(v) ? nlohmann::ordered_json(v) : nlohmann::ordered_json(); };
  for (const FigureSection& section : sections) {
    nlohmann::ordered_json& out = root[section.name];
    out["notes"] = section.notes;
    for (const Figure& figure : section.figures) out[figure.name] = number(figure.value);
    for (const FigureTable& table : section.tables) {
      nlohmann::ordered_json rows = nlohmann::ordered_json::array();
      for (const auto& row : table.rows) {
        nlohmann::ordered_json entry;
        for (size_t i = 0; i < row.size(); ++i) {
          const auto* word = std::get_if<std::string>(&row[i]);
          entry[table.columns[i].name] = word ? nlohmann::ordered_json(*word) : number(std::get<double>(row[i]));
        }
        rows.push_back(std::move(entry));
      }
      out[table.name] = std::move(rows);
    }
  }
  return root.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace iris::exporters
