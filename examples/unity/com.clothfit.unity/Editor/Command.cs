using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Linq;
using System.Text;

namespace Clothfit.Editing
{
    /// <summary>The installed command line, and how it is started.</summary>
    public sealed class Command
    {
        public const string Name = "clothfit";

        readonly string program;
        readonly string[] first;

        /// <summary>
        /// A program, by its path or a name that is looked up, and the arguments that come before those of each call,
        /// such as -m clothfit where the program is a Python. Throws InvalidOperationException where it is not found.
        /// </summary>
        public Command(string program, params string[] first)
        {
            this.program = Find(program);
            this.first = first;
            if (this.program == null)
                throw new InvalidOperationException("the program " + program + " was not found; say where it is in Edit > "
                    + "Preferences > Clothfit (on macOS: Unity > Settings)");
        }

        /// <summary>What starts the program with arguments, in a folder, with its streams in UTF-8.</summary>
        public ProcessStartInfo Call(IEnumerable<string> arguments, string folder)
        {
            var call = new ProcessStartInfo
            {
                FileName = program, Arguments = Line(first.Concat(arguments)), WorkingDirectory = folder,
                UseShellExecute = false, CreateNoWindow = true,
                RedirectStandardInput = true, RedirectStandardOutput = true, RedirectStandardError = true,
                StandardOutputEncoding = Encoding.UTF8, StandardErrorEncoding = Encoding.UTF8,
            };
            call.EnvironmentVariables["PYTHONIOENCODING"] = "utf-8";
            call.EnvironmentVariables["NO_COLOR"] = "1";
            return call;
        }

        /// <summary>
        /// Arguments as one line. Mono takes it apart on Unix as a shell does; Windows, and .NET everywhere, by the rules
        /// of Microsoft's C library.
        /// </summary>
        public static string Line(IEnumerable<string> arguments)
        {
            bool mono = Type.GetType("Mono.Runtime") != null && Path.DirectorySeparatorChar == '/';
            return string.Join(" ", arguments.Select(each => mono ? AsInShell(each) : AsInWindows(each)));
        }

        static string AsInShell(string argument)
        {
            return "\"" + argument.Replace("\\", "\\\\").Replace("\"", "\\\"").Replace("`", "\\`").Replace("$", "\\$") + "\"";
        }

        /// <summary>Backslashes count twice before a quotation mark only.</summary>
        public static string AsInWindows(string argument)
        {
            var text = new StringBuilder("\"");
            int slashes = 0;
            foreach (char each in argument)
            {
                if (each == '"') text.Append('\\', slashes + 1);
                slashes = each == '\\' ? slashes + 1 : 0;
                text.Append(each);
            }
            return text.Append('\\', slashes).Append('"').ToString();
        }

        /// <summary>The path of a program; null where there is none. Editors do not have the PATH of a terminal.</summary>
        static string Find(string name)
        {
            bool windows = Path.DirectorySeparatorChar == '\\';
            if (name.IndexOf(Path.DirectorySeparatorChar) >= 0 || name.IndexOf('/') >= 0) return Existing(name, windows);
            string home = Environment.GetFolderPath(Environment.SpecialFolder.UserProfile);
            IEnumerable<string> folders = (Environment.GetEnvironmentVariable("PATH") ?? "").Split(Path.PathSeparator)
                .Concat(new[] { Path.Combine(home, ".local", "bin"), "/opt/homebrew/bin", "/usr/local/bin" });
            return folders.Where(each => each.Length > 0).Select(each => Existing(Path.Combine(each.Trim('"'), name), windows))
                .FirstOrDefault(each => each != null);
        }

        static string Existing(string path, bool windows)
        {
            if (windows && !File.Exists(path)) path += ".exe";
            return File.Exists(path) ? path : null;
        }
    }
}
