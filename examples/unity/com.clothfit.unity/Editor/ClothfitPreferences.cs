using System;
using UnityEditor;
using UnityEngine;

namespace Clothfit.Editing
{
    /// <summary>Where the command line is: of this user and machine, not of the project.</summary>
    public static class ClothfitPreferences
    {
        const string ProgramKey = "Clothfit.Program", FirstKey = "Clothfit.FirstArguments";

        public static string Program
        {
            get { return EditorPrefs.GetString(ProgramKey, Command.Name); }
            set { EditorPrefs.SetString(ProgramKey, value); }
        }

        public static string FirstArguments
        {
            get { return EditorPrefs.GetString(FirstKey, ""); }
            set { EditorPrefs.SetString(FirstKey, value); }
        }

        /// <summary>Throws InvalidOperationException where the program is not there.</summary>
        public static Command Chosen()
        {
            return new Command(Program, FirstArguments.Split(new[] { ' ' }, StringSplitOptions.RemoveEmptyEntries));
        }

        [SettingsProvider]
        public static SettingsProvider Page()
        {
            return new SettingsProvider("Preferences/Clothfit", SettingsScope.User) { label = "Clothfit", guiHandler = Draw };
        }

        static void Draw(string search)
        {
            Program = EditorGUILayout.TextField(new GUIContent("Program", "Name or path of clothfit, or of a Python that has it"), Program);
            const string before = "What stands before the arguments of each call: -m clothfit for a Python";
            FirstArguments = EditorGUILayout.TextField(new GUIContent("First arguments", before), FirstArguments);
            if (!GUILayout.Button("Choose…")) return;
            string chosen = EditorUtility.OpenFilePanel("The program clothfit", "", "");
            if (chosen.Length > 0) Program = chosen;
        }
    }
}
