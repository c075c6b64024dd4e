// Options, declared once. A stage's option struct holds the members with their defaults; its declare() adds each of
// them to an OptionSet with unit, range and help. Command line, options file, range checks, --help and the fingerprint
// that decides what must be computed again all come from that one declaration.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

namespace iris {

class OptionSet {
 public:
  struct Option {
    std::string name;  // "stereo.disparities"
    std::variant<bool*, int*, double*, std::string*> value;
    std::string unit;  // "px", "m", … or empty
    std::string help;
    double min = -std::numeric_limits<double>::infinity();  // numbers: both bounds included
    double max = std::numeric_limits<double>::infinity();
    std::vector<std::string> choices;  // strings: the allowed values; empty = any
    std::string default_text;
    std::function<void()> apply;  // presets: sets the options that the chosen name stands for
  };

  // Everything declared after this call is named "<section>.<name>".
  void section(std::string_view name) { section_ = name; }

  void add(std::string_view name, bool& value, std::string_view help);
  void add(std::string_view name, int& value, std::string_view unit, int min, int max, std::string_view help);
  void add(std::string_view name, double& value, std::string_view unit, double min, double max, std::string_view help);
  void add(std::string_view name, std::string& value, std::vector<std::string> choices, std::string_view help);

  // A preset: a name for the values of several other options. `apply` sets them; it is called whenever `value` is set
  // to one of the choices.
  void add_preset(std::string_view name, std::string& value, std::vector<std::string> choices,
                  std::function<void()> apply, std::string_view help);

  const std::vector<Option>& options() const { return options_; }

  // Sets one option from text. Throws UsageError for an unknown name (with the nearest known one) or text that is no
  // value.
  void set(std::string_view name, std::string_view text);

  // Sets options that come from one place (a file, the command line), as (name, text): presets first, whatever the
  // order, so that what is given explicitly beside a preset wins. A preset overrides everything set before.
  void set_all(const std::vector<std::pair<std::string, std::string>>& values);

  // Reads a TOML file with [section] tables or dotted keys; the file counts as one place in the sense of set_all.
  // Throws InputError naming the file and the key.
  void read_toml(const std::filesystem::path& path);

  // The same of a file that to_toml wrote, maybe another version's: options that are not known (any more) are left out
  // and returned.
  std::vector<std::string> read_saved_toml(const std::filesystem::path& path);

  // The options of these sections (none named: all) as TOML, with unit and help as comments; read_toml of it gives the
  // same values back.
  std::string to_toml(const std::vector<std::string>& sections = {}) const;

  // Throws UsageError that lists every value that violates its range, with value and constraint.
  void validate() const;

  // "name=value" lines of the options whose name starts with one of the section names, in order of declaration:
  // two runs with the same text compute the same.
  std::string text_of(const std::vector<std::string>& sections) const;

 private:
  void push(Option option);
  std::string section_;
  std::vector<Option> options_;
};

// The value as the options file writes it (numbers with full precision).
std::string to_text(const OptionSet::Option& option);

// 64-bit FNV-1a over the bytes of `text`, as 16 hexadecimal digits: the fingerprint of inputs and options.
std::string fingerprint(std::string_view text);

}  // namespace iris
