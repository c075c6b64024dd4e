#include "iris/core/options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

struct Sample {
  bool refine = true;
  int disparities = 64;
  double margin = 0.8;
  double scale = 1;
  std::string interpolation = "within";
  std::string label = "none";

  void declare(OptionSet& set) {
    set.section("stereo");
    set.add("refine", refine, "refines");
    set.add("disparities", disparities, "px", 1, 1024, "searched range");
    set.add("margin", margin, "", 0, 100, "smallest margin");
    set.section("map");
    set.add("scale", scale, "m", 1e-6, 1e6, "scale");
    set.add("interpolation", interpolation, {"off", "within", "everywhere"}, "which gaps are filled");
    set.add("label", label, {}, "a text");
  }
};

template <class Error>
std::string message_of(const std::function<void()>& body) {
  try {
    body();
  } catch (const Error& error) {
    return error.what();
  }
  return "no exception of this kind";
}

class Options : public ::testing::Test {
 protected:
  Options() { sample_.declare(set_); }
  Sample sample_;
  OptionSet set_;
  const testing::TemporaryFolder folder_;
  const std::filesystem::path toml_ = folder_.path() / "options.toml";
};

TEST_F(Options, AreNamedAfterTheirSectionAndRememberTheirDefaults) {
  std::vector<std::string> names, defaults;
  for (const OptionSet::Option& option : set_.options()) {
    names.push_back(option.name);
    defaults.push_back(option.default_text);
  }
  EXPECT_THAT(names, ElementsAre("stereo.refine", "stereo.disparities", "stereo.margin", "map.scale",
                                 "map.interpolation", "map.label"));
  EXPECT_THAT(defaults, ElementsAre("true", "64", "0.8", "1.0", "within", "none"));
  set_.set("stereo.disparities", "128");
  EXPECT_EQ(set_.options()[1].default_text, "64");
  int again = 0;
  set_.section("stereo");
  EXPECT_THROW(set_.add("disparities", again, "", 0, 1, "a name twice"), Bug);
}

TEST_F(Options, AreSetFromText) {
  set_.set("stereo.refine", "false");
  set_.set("stereo.disparities", "96");
  set_.set("stereo.margin", "1e-3");
  set_.set("map.scale", "3");
  set_.set("map.label", "it's = 5");
  EXPECT_FALSE(sample_.refine);
  EXPECT_EQ(sample_.disparities, 96);
  EXPECT_EQ(sample_.margin, 1e-3);
  EXPECT_EQ(sample_.scale, 3);
  EXPECT_EQ(sample_.label, "it's = 5");
}

// A preset stands for the values of other options.
struct WithPreset {
  std::string preset = "fine";
  int step = 1;
  double scale = 0.5;

  void declare(OptionSet& set) {
    set.section("a");
    set.add_preset(
        "preset", preset, {"fine", "coarse"}, [this] { step = preset == "coarse" ? 8 : 1; }, "a preset");
    set.add("step", step, "px", 1, 16, "a step");
    set.add("scale", scale, "m", 0, 1, "a scale");
  }
};

TEST_F(Options, APresetGivesWayToWhatIsSetBesideItInAnyOrder) {
  WithPreset sample;
  OptionSet set;
  sample.declare(set);
  set.set_all({{"a.scale", "0.25"}, {"a.preset", "coarse"}});
  EXPECT_EQ(sample.step, 8);
  EXPECT_EQ(sample.scale, 0.25);
  set.set_all({{"a.step", "3"}, {"a.preset", "coarse"}});
  EXPECT_EQ(sample.step, 3);
  set.set_all({{"a.preset", "fine"}});  // given later and elsewhere: wins over the step
  EXPECT_EQ(sample.step, 1);
  write_file(toml_, std::string_view("[a]\nstep = 5\npreset = 'coarse'\n"));
  set.read_toml(toml_);
  EXPECT_EQ(sample.step, 5);
  // The options of a result are explicit: reading them gives the same, whatever the preset stands for by then.
  WithPreset again;
  OptionSet other;
  again.declare(other);
  write_file(toml_, set.to_toml());
  other.read_toml(toml_);
  EXPECT_EQ(other.to_toml(), set.to_toml());
  set.set("a.preset", "fast");
  EXPECT_THAT(message_of<UsageError>([&] { set.validate(); }), HasSubstr("a.preset = fast must be one of fine|coarse"));
}

TEST_F(Options, RefuseTextThatIsNoValue) {
  for (const auto& [name, text] :
       std::vector<std::pair<std::string, std::string>>{{"stereo.refine", "yes"},
                                                        {"stereo.refine", ""},
                                                        {"stereo.disparities", "64px"},
                                                        {"stereo.disparities", "6.5"},
                                                        {"stereo.disparities", "99999999999"},
                                                        {"stereo.disparities", ""},
                                                        {"stereo.margin", "0,8"},
                                                        {"stereo.margin", "much"}}) {
    EXPECT_THAT(message_of<UsageError>([&] { set_.set(name, text); }),
                AllOf(HasSubstr(name), HasSubstr("'" + text + "'")));
  }
  EXPECT_EQ(sample_.disparities, 64);
}

TEST_F(Options, NameTheNearestWhenUnknown) {
  EXPECT_EQ(message_of<UsageError>([&] { set_.set("stereo.disparites", "1"); }),
            "unknown option stereo.disparites; did you mean stereo.disparities?");
  EXPECT_THAT(message_of<UsageError>([&] { set_.set("disparities", "1"); }), StartsWith("unknown option disparities"));
  EXPECT_EQ(message_of<UsageError>([&] { set_.set("zzz", "1"); }), "unknown option zzz");
}

TEST_F(Options, ListAllViolationsAtOnce) {
  set_.validate();
  sample_.disparities = 0;
  sample_.margin = std::numeric_limits<double>::quiet_NaN();
  sample_.scale = 2e6;
  sample_.interpolation = "some";
  const std::string message = message_of<UsageError>([&] { set_.validate(); });
  EXPECT_THAT(message, HasSubstr("stereo.disparities = 0 must be 1 to 1024 px"));
  EXPECT_THAT(message, HasSubstr("stereo.margin = nan must be 0 to 100"));
  EXPECT_THAT(message, HasSubstr("map.scale = 2000000.0 must be 1e-06 to 1000000 m"));
  EXPECT_THAT(message, HasSubstr("map.interpolation = some must be one of off|within|everywhere"));
  EXPECT_EQ(std::count(message.begin(), message.end(), '\n'), 3);
}

TEST_F(Options, BoundsBelongToTheRange) {
  for (const int value : {1, 1024}) {
    sample_.disparities = value;
    set_.validate();
  }
  sample_.disparities = 1025;
  EXPECT_THROW(set_.validate(), UsageError);
}

TEST_F(Options, ComeBackFromTheirToml) {
  sample_ = {.refine = false,
             .disparities = 7,
             .margin = 0.1 + 0.2,
             .scale = 1e-6,
             .interpolation = "off",
             .label = "C:\\a \"b\" # c\tä\n"};
  write_file(toml_, set_.to_toml());
  Sample other;
  OptionSet others;
  other.declare(others);
  others.read_toml(toml_);
  EXPECT_EQ(other.refine, sample_.refine);
  EXPECT_EQ(other.disparities, sample_.disparities);
  EXPECT_EQ(other.margin, sample_.margin);
  EXPECT_EQ(other.scale, sample_.scale);
  EXPECT_EQ(other.interpolation, sample_.interpolation);
  EXPECT_EQ(other.label, sample_.label);
  EXPECT_EQ(others.to_toml(), set_.to_toml());
}

TEST_F(Options, TomlTeachesUnitsRangesAndHelp) {
  EXPECT_THAT(set_.to_toml(),
              AllOf(HasSubstr("[stereo]\n"), HasSubstr("disparities = 64  # [px] searched range; 1 to 1024\n"),
                    HasSubstr("interpolation = \"within\"  # which gaps are filled; one of off|within|everywhere\n")));
}

TEST_F(Options, TomlOfSomeSectionsHoldsThemAlone) {
  const std::string whole = set_.to_toml(), stereo = set_.to_toml({"stereo"});
  EXPECT_THAT(stereo, AllOf(HasSubstr("[stereo]\n"), Not(HasSubstr("[map]"))));
  EXPECT_THAT(whole, AllOf(HasSubstr(stereo), HasSubstr("[map]")));
  EXPECT_EQ(set_.to_toml({"ster"}), "");
}

TEST_F(Options, AreReadFromTablesAndDottedKeys) {
  write_file(toml_, std::string_view("stereo.disparities = 32\nmap.scale = 2\n[map]\nlabel = 'x'\n"));
  EXPECT_THROW(set_.read_toml(toml_), InputError);  // TOML forbids to open the same table twice
  write_file(toml_, std::string_view("stereo.disparities = 32\n[map]\nscale = 2\nlabel = 'x'\n"));
  set_.read_toml(toml_);
  EXPECT_EQ(sample_.disparities, 32);
  EXPECT_EQ(sample_.scale, 2);
  EXPECT_EQ(sample_.label, "x");
}

TEST_F(Options, ErrorsOfAFileNameTheFileAndTheKey) {
  EXPECT_THAT(message_of<InputError>([&] { set_.read_toml(toml_); }), HasSubstr(toml_.string()));
  write_file(toml_, std::string_view("[stereo]\n\ndisparities = = 3\n"));
  EXPECT_THAT(message_of<InputError>([&] { set_.read_toml(toml_); }),
              AllOf(HasSubstr(toml_.string()), HasSubstr("line 3")));
  write_file(toml_, std::string_view("[stereo]\ndisparity = 3\n"));
  EXPECT_THAT(message_of<UsageError>([&] { set_.read_toml(toml_); }),
              AllOf(HasSubstr(toml_.string()), HasSubstr("unknown option stereo.disparity; did you mean")));
  write_file(toml_, std::string_view("[stereo]\ndisparities = [1, 2]\n"));
  EXPECT_THAT(message_of<InputError>([&] { set_.read_toml(toml_); }),
              AllOf(HasSubstr(toml_.string()), HasSubstr("stereo.disparities")));
  write_file(toml_, std::string_view("[stereo]\ndisparities = 6.5\n"));
  EXPECT_THAT(message_of<UsageError>([&] { set_.read_toml(toml_); }), HasSubstr("stereo.disparities"));
}

TEST_F(Options, ASavedFileOfAnotherVersionIsReadWithoutWhatIsNotKnown) {
  write_file(toml_, std::string_view("[stereo]\ndisparities = 32\nold = 3\n[gone]\nlabel = 'x'\n"));
  EXPECT_THAT(set_.read_saved_toml(toml_), ::testing::UnorderedElementsAre("stereo.old", "gone.label"));
  EXPECT_EQ(sample_.disparities, 32);
  EXPECT_THAT(set_.read_saved_toml(toml_), ::testing::SizeIs(2));
  write_file(toml_, set_.to_toml());
  EXPECT_THAT(set_.read_saved_toml(toml_), ::testing::IsEmpty());
  write_file(toml_, std::string_view("[stereo]\ndisparities = 6.5\n"));
  EXPECT_THAT(message_of<UsageError>([&] { set_.read_saved_toml(toml_); }), HasSubstr("stereo.disparities"));
}

TEST_F(Options, TextOfTakesTheSectionsAskedForAndChangesWithEveryValue) {
  EXPECT_EQ(set_.text_of({"stereo"}), "stereo.refine=true\nstereo.disparities=64\nstereo.margin=0.8\n");
  EXPECT_EQ(set_.text_of({"map", "stereo"}), set_.text_of({"stereo", "map"}));  // the order of declaration
  EXPECT_EQ(set_.text_of({"ster"}), "");                                        // a section, not a prefix
  const std::string before = set_.text_of({"stereo"});
  sample_.scale = 5;
  EXPECT_EQ(set_.text_of({"stereo"}), before);
  sample_.margin = std::nextafter(sample_.margin, 1);
  EXPECT_NE(set_.text_of({"stereo"}), before);
}

// Published test vectors of 64-bit FNV-1a.
TEST(Fingerprint, IsFnv1a) {
  EXPECT_EQ(fingerprint(""), "cbf29ce484222325");
  EXPECT_EQ(fingerprint("a"), "af63dc4c8601ec8c");
  EXPECT_EQ(fingerprint("foobar"), "85944171f73967e8");
}

}  // namespace
}  // namespace iris
