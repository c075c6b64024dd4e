#include "iris/core/options.h"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <limits>

#include "iris/core/error.h"

namespace iris {
namespace {

size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<size_t> row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t above = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (a[i - 1] != b[j - 1])});
      diagonal = above;
    }
  }
  return row[b.size()];
}

template <class Number>
bool parse_number(std::string_view text, Number& value) {
  Number parsed;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), parsed);
  if (error != std::errc() || end != text.data() + text.size()) return false;
  value = parsed;
  return true;
}

std::string bound_text(double bound) {
  return bound == std::floor(bound) && std::abs(bound) < 1e15 ? fmt::format("{:.0f}", bound) : fmt::format("{}", bound);
}

std::string range_text(const OptionSet::Option& option) {
  if (!option.choices.empty()) return fmt::format("one of {}", fmt::join(option.choices, "|"));
  const bool low = std::isfinite(option.min) && option.min > std::numeric_limits<int>::min();
  const bool high = std::isfinite(option.max) && option.max < std::numeric_limits<int>::max();
  if (low && high) return fmt::format("{} to {}", bound_text(option.min), bound_text(option.max));
  if (low) return fmt::format(">= {}", bound_text(option.min));
  if (high) return fmt::format("<= {}", bound_text(option.max));
  return "";
}

// Flattens [a.b] tables into "a.b.c" keys.
void visit_leaves(const toml::table& table, const std::string& prefix,
                  const std::function<void(const std::string&, const toml::node&)>& visit) {
  for (const auto& [key, node] : table) {
    const std::string name = prefix.empty() ? std::string(key.str()) : prefix + "." + std::string(key.str());
    if (const toml::table* inner = node.as_table()) {
      visit_leaves(*inner, name, visit);
    } else {
      visit(name, node);
    }
  }
}

}  // namespace

std::string to_text(const OptionSet::Option& option) {
  struct Text {
    std::string operator()(const bool* v) const { return *v ? "true" : "false"; }
    std::string operator()(const int* v) const { return std::to_string(*v); }
    std::string operator()(const double* v) const {
      const std::string text = fmt::format("{}", *v);  // shortest text that reads back as the same number
      return std::isfinite(*v) && text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
    }
    std::string operator()(const std::string* v) const { return *v; }
  };
  return std::visit(Text{}, option.value);
}

void OptionSet::push(Option option) {
  option.default_text = to_text(option);
  for (const Option& other : options_) IRIS_CHECK(other.name != option.name);
  options_.push_back(std::move(option));
}

void OptionSet::add(std::string_view name, bool& value, std::string_view help) {
  push({.name = section_.empty() ? std::string(name) : section_ + "." + std::string(name),
        .value = &value,
        .unit = "",
        .help = std::string(help),
        .choices = {},
        .default_text = "",
        .apply = {}});
}

void OptionSet::add(std::string_view name, int& value, std::string_view unit, int min, int max, std::string_view help) {
  push({.name = section_.empty() ? std::string(name) : section_ + "." + std::string(name),
        .value = &value,
        .unit = std::string(unit),
        .help = std::string(help),
        .min = static_cast<double>(min),
        .max = static_cast<double>(max),
        .choices = {},
        .default_text = "",
        .apply = {}});
}

void OptionSet::add(std::string_view name, double& value, std::string_view unit, double min, double max,
                    std::string_view help) {
  push({.name = section_.empty() ? std::string(name) : section_ + "." + std::string(name),
        .value = &value,
        .unit = std::string(unit),
        .help = std::string(help),
        .min = min,
        .max = max,
        .choices = {},
        .default_text = "",
        .apply = {}});
}

void OptionSet::add(std::string_view name, std::string& value, std::vector<std::string> choices,
                    std::string_view help) {
  push({.name = section_.empty() ? std::string(name) : section_ + "." + std::string(name),
        .value = &value,
        .unit = "",
        .help = std::string(help),
        .choices = std::move(choices),
        .default_text = "",
        .apply = {}});
}

void OptionSet::add_preset(std::string_view name, std::string& value, std::vector<std::string> choices,
                           std::function<void()> apply, std::string_view help) {
  add(name, value, std::move(choices), help);
  options_.back().apply = std::move(apply);
}

void OptionSet::set(std::string_view name, std::string_view text) {
  const auto found = std::find_if(options_.begin(), options_.end(), [&](const Option& o) { return o.name == name; });
  if (found == options_.end()) {
    std::string message = fmt::format("unknown option {}", name);
    const auto nearest = std::min_element(options_.begin(), options_.end(), [&](const Option& a, const Option& b) {
      return edit_distance(a.name, name) < edit_distance(b.name, name);
    });
    if (nearest != options_.end() && edit_distance(nearest->name, name) <= 1 + name.size() / 3) {
      message += fmt::format("; did you mean {}?", nearest->name);
    }
    throw UsageError(message);
  }
  struct Parse {
    std::string_view text;
    bool operator()(bool* v) const {
      if (text != "true" && text != "false") return false;
      *v = text == "true";
      return true;
    }
    bool operator()(int* v) const { return parse_number(text, *v); }
    bool operator()(double* v) const { return parse_number(text, *v); }
    bool operator()(std::string* v) const {
      *v = std::string(text);
      return true;
    }
  };
  if (!std::visit(Parse{text}, found->value)) {
    static constexpr const char* kKinds[] = {"true or false", "a whole number", "a number", "text"};
    throw UsageError(fmt::format("{} = '{}' is not {}", name, text, kKinds[found->value.index()]));
  }
  // A name that is no choice is left for validate(), which tells all problems at once.
  const auto known = [&] { return std::find(found->choices.begin(), found->choices.end(), text); };
  if (found->apply && known() != found->choices.end()) found->apply();
}

void OptionSet::set_all(const std::vector<std::pair<std::string, std::string>>& values) {
  const auto is_preset = [&](const std::string& name) {
    return std::any_of(options_.begin(), options_.end(), [&](const Option& o) { return o.name == name && o.apply; });
  };
  for (const bool presets : {true, false}) {
    for (const auto& [name, text] : values) {
      if (is_preset(name) == presets) set(name, text);
    }
  }
}

namespace {

using Values = std::vector<std::pair<std::string, std::string>>;

Values values_of(const std::filesystem::path& path) {
  if (!std::filesystem::exists(path)) throw InputError(path, "there is no such file", "check the name after --config");
  toml::table table;
  try {
    table = toml::parse_file(path.string());
  } catch (const toml::parse_error& error) {
    throw InputError(path, fmt::format("line {}: {}", error.source().begin.line, error.description()),
                     "mend this line; the file is TOML, as in stereo.disparities = 64");
  }
  Values values;
  visit_leaves(table, "", [&](const std::string& name, const toml::node& node) {
    std::string text;
    if (const auto* v = node.as_string())
      text = v->get();
    else if (const auto* v = node.as_integer())
      text = std::to_string(v->get());
    else if (const auto* v = node.as_floating_point())
      text = fmt::format("{}", v->get());
    else if (const auto* v = node.as_boolean())
      text = v->get() ? "true" : "false";
    else
      throw InputError(path, name + " is neither text, number nor true/false", "see iris run --help for the options");
    values.emplace_back(name, text);
  });
  return values;
}

}  // namespace

void OptionSet::read_toml(const std::filesystem::path& path) {
  try {
    set_all(values_of(path));
  } catch (const UsageError& error) {
    throw UsageError(path.string() + ": " + error.what());
  }
}

std::vector<std::string> OptionSet::read_saved_toml(const std::filesystem::path& path) {
  Values values = values_of(path);
  std::vector<std::string> unknown;
  std::erase_if(values, [&](const auto& value) {
    const bool known =
        std::any_of(options_.begin(), options_.end(), [&](const Option& o) { return o.name == value.first; });
    if (!known) unknown.push_back(value.first);
    return !known;
  });
  try {
    set_all(values);
  } catch (const UsageError& error) {
    throw UsageError(path.string() + ": " + error.what());
  }
  return unknown;
}

std::string OptionSet::to_toml(const std::vector<std::string>& sections) const {
  std::string text, section;
  for (const Option& option : options_) {
    const size_t dot = option.name.rfind('.');
    const std::string own_section = dot == std::string::npos ? "" : option.name.substr(0, dot);
    if (!sections.empty() && std::find(sections.begin(), sections.end(), own_section) == sections.end()) continue;
    if (own_section != section) {
      section = own_section;
      text += fmt::format("\n[{}]\n", section);
    }
    const bool quoted = std::holds_alternative<std::string*>(option.value);
    std::string value = to_text(option);
    if (quoted) {
      std::string escaped;
      for (const char c : value) {
        if (static_cast<unsigned char>(c) < 0x20) {
          escaped += fmt::format("\\u{:04X}", static_cast<int>(c));
          continue;
        }
        if (c == '"' || c == '\\') escaped += '\\';
        escaped += c;
      }
      value = '"' + escaped + '"';
    }
    const std::string range = range_text(option);
    text += fmt::format("{} = {}  # {}{}{}\n", option.name.substr(dot == std::string::npos ? 0 : dot + 1), value,
                        option.unit.empty() ? "" : "[" + option.unit + "] ", option.help,
                        range.empty() ? "" : "; " + range);
  }
  return text;
}

void OptionSet::validate() const {
  std::string problems;
  for (const Option& option : options_) {
    bool good = true;
    if (const auto* v = std::get_if<int*>(&option.value)) good = **v >= option.min && **v <= option.max;
    if (const auto* v = std::get_if<double*>(&option.value)) good = **v >= option.min && **v <= option.max;
    if (const auto* v = std::get_if<std::string*>(&option.value); v && !option.choices.empty()) {
      good = std::find(option.choices.begin(), option.choices.end(), **v) != option.choices.end();
    }
    if (!good) {
      problems += fmt::format("{}{} = {} must be {}{}", problems.empty() ? "" : "\n", option.name, to_text(option),
                              range_text(option), option.unit.empty() ? "" : " " + option.unit);
    }
  }
  if (!problems.empty()) throw UsageError(problems);
}

std::string OptionSet::text_of(const std::vector<std::string>& sections) const {
  std::string text;
  for (const Option& option : options_) {
    for (const std::string& section : sections) {
      if (option.name.starts_with(section + ".") || option.name == section) {
        text += option.name + "=" + to_text(option) + "\n";
        break;
      }
    }
  }
  return text;
}

std::string fingerprint(std::string_view text) {
  uint64_t hash = 14695981039346656037ull;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ull;
  return fmt::format("{:016x}", hash);
}

}  // namespace iris
