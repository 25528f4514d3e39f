// UnityEditor, as far as the package uses it.

using System;
using System.Collections.Generic;
using UnityEngine;
using Object = UnityEngine.Object;

namespace UnityEditor
{
    [AttributeUsage(AttributeTargets.Method, AllowMultiple = true)]
    public sealed class MenuItem : Attribute
    {
        public readonly string Path;
        public readonly bool Validates;

        public MenuItem(string path)
        {
            Path = path;
        }

        public MenuItem(string path, bool validates) : this(path)
        {
            Validates = validates;
        }

        public MenuItem(string path, bool validates, int priority) : this(path, validates)
        {
        }
    }

    /// <summary>`update` is called again and again by the editor; here by a harness.</summary>
    public static class EditorApplication
    {
        public delegate void CallbackFunction();

        public static CallbackFunction update;

        public static event Action quitting;

        public static void Tick()
        {
            if (update != null) update();
        }

        public static void Quit()
        {
            if (quitting != null) quitting();
        }
    }

    public static class AssemblyReloadEvents
    {
        public delegate void AssemblyReloadCallback();

        public static event AssemblyReloadCallback beforeAssemblyReload;

        public static void Reload()
        {
            if (beforeAssemblyReload != null) beforeAssemblyReload();
        }
    }

    /// <summary>The lines of the window Progress.</summary>
    public static class Progress
    {
        public enum Status
        {
            Running,
            Succeeded,
            Failed,
            Canceled,
            Paused,
        }

        [Flags]
        public enum Options
        {
            None = 0,
            Sticky = 1,
            Indefinite = 2,
            Synchronous = 4,
            Managed = 8,
            Unmanaged = 16,
        }

        public sealed class Line
        {
            public string Name, Description;
            public Status Status;
            public Func<bool> Cancel;
        }

        public static readonly List<Line> Lines = new List<Line>();

        public static int Start(string name, string description = null, Options options = Options.None, int parentId = -1)
        {
            Lines.Add(new Line { Name = name, Description = description });
            return Lines.Count - 1;
        }

        public static void SetDescription(int id, string description)
        {
            Lines[id].Description = description;
        }

        public static void RegisterCancelCallback(int id, Func<bool> callback)
        {
            Lines[id].Cancel = callback;
        }

        public static void Finish(int id, Status status = Status.Succeeded)
        {
            Lines[id].Status = status;
        }
    }

    public static class EditorPrefs
    {
        static readonly Dictionary<string, string> Kept = new Dictionary<string, string>();

        public static string GetString(string key, string otherwise)
        {
            string found;
            return Kept.TryGetValue(key, out found) ? found : otherwise;
        }

        public static void SetString(string key, string value)
        {
            Kept[key] = value;
        }
    }

    public static class EditorUtility
    {
        public static readonly List<string> Dialogs = new List<string>();

        public static bool DisplayDialog(string title, string message, string ok)
        {
            Dialogs.Add(message);
            return true;
        }

        public static string OpenFilePanel(string title, string directory, string extension)
        {
            return "";
        }

        public static void SetDirty(Object target)
        {
        }
    }

    public static class EditorGUILayout
    {
        public static string TextField(GUIContent label, string text)
        {
            return text;
        }
    }

    public enum SettingsScope
    {
        User,
        Project,
    }

    [AttributeUsage(AttributeTargets.Method)]
    public sealed class SettingsProviderAttribute : Attribute
    {
    }

    public class SettingsProvider
    {
        public SettingsProvider(string path, SettingsScope scopes, IEnumerable<string> keywords = null)
        {
        }

        public string label { get; set; }
        public Action<string> guiHandler { get; set; }
    }

    public static class Selection
    {
        public static GameObject activeGameObject;
    }

    public static class Undo
    {
        public static readonly List<Object> Recorded = new List<Object>();

        public static void RecordObject(Object it, string name)
        {
            Recorded.Add(it);
        }

        public static void RegisterCreatedObjectUndo(Object it, string name)
        {
        }

        public static T AddComponent<T>(GameObject to) where T : Component
        {
            return to.AddComponent<T>();
        }
    }
}
